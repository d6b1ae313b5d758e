//! Sets of Gaussians as one array per property, written as a table with one row per property.
//!
//! [`columns!`](crate::columns!) turns the rows into the record of one Gaussian, the arrays of many, and everything
//! that treats all properties alike: copies, lengths, reading. [`Column`] is a property of all Gaussians as plain
//! numbers, for files, comparisons and other languages.

/// Numbers of a property, value after value.
#[derive(Clone, Debug, PartialEq)]
pub enum Numbers<'a> {
    /// Measures.
    Floats(&'a [f32]),
    /// Counts and identities.
    Words(&'a [u64]),
    /// Codes of choices.
    Codes(Vec<u8>),
}

impl Numbers<'_> {
    /// The numbers in little-endian bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        match self {
            Numbers::Floats(numbers) => numbers.iter().flat_map(|x| x.to_le_bytes()).collect(),
            Numbers::Words(numbers) => numbers.iter().flat_map(|x| x.to_le_bytes()).collect(),
            Numbers::Codes(numbers) => numbers.clone(),
        }
    }
}

/// A value of a property.
pub trait Value: Copy + Default + PartialEq + 'static {
    /// Numbers per value.
    const WIDTH: usize = 1;

    /// The numbers of `values`.
    fn numbers(values: &[Self]) -> Numbers<'_>;

    /// The values whose numbers are these bytes, as of [`Numbers::to_bytes`].
    ///
    /// # Errors
    /// A code that stands for no value.
    fn from_bytes(bytes: &[u8]) -> Result<Vec<Self>, u8>;

    /// 0 if every number is finite, otherwise NaN. Sums of it test many numbers without a branch for each.
    fn undefined(self) -> f32 {
        0.0
    }
}

/// Numbers and arrays of them as values.
macro_rules! numbers {
    ($($Kind:ident($Number:ident): $undefined:expr;)+) => {
        $(impl Value for $Number {
            fn numbers(values: &[Self]) -> Numbers<'_> {
                Numbers::$Kind(values)
            }

            fn from_bytes(bytes: &[u8]) -> Result<Vec<Self>, u8> {
                Ok(bytes.as_chunks().0.iter().map(|bytes| Self::from_le_bytes(*bytes)).collect())
            }

            fn undefined(self) -> f32 {
                $undefined(self)
            }
        }

        impl<const K: usize> Value for [$Number; K]
        where
            Self: Default,
        {
            const WIDTH: usize = K;

            fn numbers(values: &[Self]) -> Numbers<'_> {
                Numbers::$Kind(values.as_flattened())
            }

            fn from_bytes(bytes: &[u8]) -> Result<Vec<Self>, u8> {
                Ok($Number::from_bytes(bytes)?.as_chunks().0.to_vec())
            }

            fn undefined(self) -> f32 {
                self.into_iter().map(Value::undefined).sum()
            }
        })+
    };
}

numbers! {
    Floats(f32): |x| 0.0 * x;
    Words(u64): |_| 0.0;
}

/// A property of all Gaussians of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct Column<'a> {
    /// The name of its array.
    pub name: &'static str,
    /// Numbers per Gaussian.
    pub width: usize,
    /// The numbers of all Gaussians, one Gaussian after the other.
    pub numbers: Numbers<'a>,
    /// The numbers of a Gaussian in data without this property; `None` if all data has it.
    pub default: Option<Numbers<'static>>,
}

impl Column<'_> {
    /// Returns true if data without this property means the same: every Gaussian has the default.
    pub fn is_default(&self) -> bool {
        fn all<T: PartialEq>(numbers: &[T], default: &[T]) -> bool {
            numbers.chunks(default.len()).all(|own| own == default)
        }
        match (&self.numbers, &self.default) {
            (Numbers::Floats(numbers), Some(Numbers::Floats(default))) => all(numbers, default),
            (Numbers::Words(numbers), Some(Numbers::Words(default))) => all(numbers, default),
            (Numbers::Codes(numbers), Some(Numbers::Codes(default))) => all(numbers, default),
            _ => false,
        }
    }
}

/// Data from which the properties of a set are read, one after the other in the order of their rows.
pub trait Source {
    /// Reason why a property cannot be read.
    type Error;

    /// Reads the values of property `name`; `default`: that of data without this property, if there may be such data.
    ///
    /// # Errors
    /// The property is missing or is of another kind.
    fn values<T: Value>(&mut self, name: &'static str, default: Option<T>) -> Result<Vec<T>, Self::Error>;
}

/// Defines a set of Gaussians from the name of the record of one, the name of the arrays of many, and a row per
/// property: its meaning, name and type, and the value of data without it if it has been added later.
///
/// ```
/// streamsplat_model::columns! {
///     /// A point.
///     Point;
///     /// Points.
///     Points;
///     /// Where it is.
///     place: [f32; 2];
///     /// How heavy it is.
///     weight: f32 = 1.0;
/// }
/// let mut points: Points = [Point { place: [2.0, 3.0], ..Point::default() }].into_iter().collect();
/// points.push(Point { weight: 5.0, ..points.get(0) });
/// assert_eq!((points.len(), points.weight), (2, vec![1.0, 5.0]));
/// ```
#[macro_export]
macro_rules! columns {
    (
        $(#[doc = $of_one:literal])+
        $Record:ident;
        $(#[doc = $of_all:literal])+
        $Arrays:ident;
        $($(#[doc = $meaning:literal])+ $name:ident: $Type:tt $(= $default:expr)?;)+
    ) => {
        $(#[doc = $of_one])+
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $Record {
            $($(#[doc = $meaning])+ pub $name: $Type,)+
        }

        impl Default for $Record {
            /// Each property's default, and zeros where it has none.
            fn default() -> Self {
                $(let $name: &[$Type] = &[$($default)?];)+
                Self { $($name: $name.first().copied().unwrap_or_default(),)+ }
            }
        }

        impl $Record {
            /// 0 if every number is finite, otherwise NaN.
            pub fn undefined(&self) -> f32 {
                0.0 $(+ $crate::columns::Value::undefined(self.$name))+
            }
        }

        $(#[doc = $of_all])+
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $Arrays {
            $(#[doc = concat!("See [`", stringify!($Record), "::", stringify!($name), "`].")] pub $name: Vec<$Type>,)+
        }

        impl $Arrays {
            /// Room for `count` records.
            pub fn with_capacity(count: usize) -> Self {
                Self { $($name: Vec::with_capacity(count),)+ }
            }

            /// Number of records.
            pub fn len(&self) -> usize {
                [$(self.$name.len()),+][0]
            }

            /// Returns true if there is none.
            pub fn is_empty(&self) -> bool {
                self.len() == 0
            }

            /// Returns record `i`. Panics when there are fewer in any array.
            pub fn get(&self, i: usize) -> $Record {
                $Record { $($name: self.$name[i],)+ }
            }

            /// Replaces record `i`. Panics when there are fewer in any array.
            pub fn set(&mut self, i: usize, record: $Record) {
                $(self.$name[i] = record.$name;)+
            }

            /// Appends a record.
            pub fn push(&mut self, record: $Record) {
                $(self.$name.push(record.$name);)+
            }

            /// Appends all records of `other`.
            pub fn append(&mut self, other: &Self) {
                $(self.$name.extend_from_slice(&other.$name);)+
            }

            /// The records in order.
            pub fn iter(&self) -> impl ExactSizeIterator<Item = $Record> + '_ {
                (0..self.len()).map(|i| self.get(i))
            }

            /// The name and length of an array that has another length than the first, if any.
            pub fn uneven(&self) -> Option<(&'static str, usize)> {
                [$((stringify!($name), self.$name.len())),+].into_iter().find(|(_, length)| *length != self.len())
            }

            /// The properties as numbers.
            pub fn columns(&self) -> Vec<$crate::columns::Column<'_>> {
                use $crate::columns::{Column, Value};
                vec![$(Column {
                    name: stringify!($name),
                    width: <$Type as Value>::WIDTH,
                    numbers: Value::numbers(&self.$name),
                    default: [$(<$Type as Value>::numbers(const { &[$default] }))?].into_iter().next(),
                },)+]
            }

            /// Reads all properties from `source`.
            ///
            /// # Errors
            /// Those of `source`.
            pub fn read<S: $crate::columns::Source>(source: &mut S) -> Result<Self, S::Error> {
                Ok(Self { $($name: source.values(stringify!($name), [$($default)?].into_iter().next())?,)+ })
            }
        }

        impl FromIterator<$Record> for $Arrays {
            fn from_iter<I: IntoIterator<Item = $Record>>(records: I) -> Self {
                let records = records.into_iter();
                let mut all = Self::with_capacity(records.size_hint().0);
                records.for_each(|record| all.push(record));
                all
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    crate::columns! {
        /// One.
        One;
        /// Many.
        Many;
        /// Three numbers.
        place: [f32; 3];
        /// A number that data may lack.
        weight: f32 = 0.5;
        /// A word.
        identity: u64;
    }

    /// Bytes of all columns, in order.
    struct Bytes(Vec<(&'static str, Vec<u8>)>);

    impl Source for Bytes {
        type Error = String;

        fn values<T: Value>(&mut self, name: &'static str, default: Option<T>) -> Result<Vec<T>, String> {
            match self.0.iter().find(|column| column.0 == name) {
                Some((_, bytes)) => T::from_bytes(bytes).map_err(|code| format!("{name}: {code}")),
                None => default.map(|default| vec![default; 2]).ok_or_else(|| format!("no {name}")),
            }
        }
    }

    fn two() -> Many {
        let one = One { place: [1.0, -2.0, 1e-45], identity: u64::MAX, ..One::default() };
        [one, One { weight: 3.0, ..one }].into_iter().collect()
    }

    #[test]
    fn records_come_back_as_they_went_in_and_are_replaced_and_appended_whole() {
        let mut all = two();
        assert_eq!((all.get(0).weight, all.get(1).weight, all.len()), (0.5, 3.0, 2));
        all.append(&two());
        all.set(1, all.get(0));
        assert_eq!(all.iter().collect::<Vec<_>>(), [0, 0, 0, 1].map(|i| two().get(i)));
        all.identity.pop();
        assert_eq!(all.uneven(), Some(("identity", 3)));
        assert_eq!((two().uneven(), Many::default().uneven(), Many::default().is_empty()), (None, None, true));
    }

    #[test]
    fn columns_are_read_from_their_bytes_and_only_those_with_a_default_may_be_missing() {
        let bytes = |all: &Many| all.columns().iter().map(|c| (c.name, c.numbers.to_bytes())).collect::<Vec<_>>();
        assert_eq!(Many::read(&mut Bytes(bytes(&two()))), Ok(two()));
        let without = |name: &str| Bytes(bytes(&two()).into_iter().filter(|column| column.0 != name).collect());
        let found = Many::read(&mut without("weight")).expect("it has a default");
        assert_eq!((found.weight, found.identity), (vec![0.5; 2], two().identity));
        assert_eq!(Many::read(&mut without("identity")), Err("no identity".to_owned()));
    }

    #[test]
    fn a_column_is_default_where_all_its_values_are() {
        let is_default = |all: &Many| all.columns().iter().map(Column::is_default).collect::<Vec<_>>();
        assert_eq!(is_default(&two()), [false; 3]);
        assert_eq!(is_default(&[two().get(0); 3].into_iter().collect()), [false, true, false]);
    }

    #[test]
    fn one_number_that_is_not_finite_is_found_in_a_record() {
        assert_eq!(two().get(1).undefined(), 0.0);
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(One { weight: bad, ..One::default() }.undefined().is_nan());
            assert!(One { place: [0.0, f32::MAX, bad], ..One::default() }.undefined().is_nan());
        }
    }
}
