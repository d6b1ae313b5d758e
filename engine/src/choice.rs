//! Choices by name: enumerations whose variants have the names of options.

/// Defines an enum of named choices with `name`, `FromStr` and `Display`.
macro_rules! named {
    ($(#[$meta:meta])* $kind:ident: $what:literal { $($(#[$variant_meta:meta])* $variant:ident = $name:literal,)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        pub enum $kind { $($(#[$variant_meta])* $variant,)+ }

        impl $kind {
            /// All choices.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// The choice's name.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }
        }

        impl std::fmt::Display for $kind {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }

        impl std::str::FromStr for $kind {
            type Err = $crate::choice::UnknownChoice;

            fn from_str(name: &str) -> Result<Self, Self::Err> {
                Self::ALL.iter().copied().find(|c| c.name() == name).ok_or_else(|| $crate::choice::UnknownChoice {
                    what: $what,
                    expected: Self::ALL.iter().map(|c| c.name()).collect::<Vec<_>>().join(", "),
                    found: name.to_owned(),
                })
            }
        }
    };
}

pub(crate) use named;

/// A name that is no choice.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown {what} {found:?}: expected one of {expected}")]
pub struct UnknownChoice {
    /// The setting.
    pub what: &'static str,
    /// Its choices.
    pub expected: String,
    /// The name given.
    pub found: String,
}
