//! The part of Python's pickle format in which `torch.save` writes tensors by name.
//!
//! A pickle is a program for a stack machine. This one builds numbers, texts, tuples, lists and dictionaries. It
//! supports only the four calls by which PyTorch describes tensors, and implements them itself. Anything else is an
//! error: no class is looked up, no code is run.
//!
//! Values are in one list in the order of their creation; the stack, the memo and containers hold their indices. So
//! every byte of a pickle creates at most one value, for any number of references to it.
//!
//! Source: CPython, `Lib/pickletools.py` (opcodes of protocols 0 to 5).

use std::collections::{BTreeMap, HashMap};

use super::super::header::Dtype;
use super::dtype;

/// A tensor as a view of a storage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Stored {
    /// Name of the storage in the archive.
    pub(super) storage: String,
    pub(super) dtype: Dtype,
    /// Elements before the first.
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    /// Elements from one index to the next, by axis.
    pub(super) stride: Vec<usize>,
}

/// Most axes of a tensor.
const MOST_AXES: usize = 16;
/// Longest name of a storage, in bytes: PyTorch numbers them.
const LONGEST_KEY: usize = 64;

/// Index of a value.
type Id = usize;

#[derive(Clone, Debug)]
enum Value {
    None,
    Bool(bool),
    Int(i64),
    Float,
    Text(String),
    Bytes,
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    /// A function or class, as `module.name`.
    Global(String),
    Storage {
        dtype: Dtype,
        key: String,
    },
    Tensor(Stored),
}

impl Value {
    /// Its name in errors.
    fn kind(&self) -> String {
        match self {
            Value::None => "None".to_owned(),
            Value::Bool(value) => format!("a truth value ({value})"),
            Value::Int(value) => format!("a whole number ({value})"),
            Value::Float => "a number".to_owned(),
            Value::Text(_) => "a text".to_owned(),
            Value::Bytes => "bytes".to_owned(),
            Value::Tuple(_) => "a tuple".to_owned(),
            Value::List(_) => "a list".to_owned(),
            Value::Dict(_) => "a dictionary".to_owned(),
            Value::Global(name) => format!("the class or function {name}"),
            Value::Storage { .. } => "a storage".to_owned(),
            Value::Tensor(_) => "a tensor".to_owned(),
        }
    }
}

/// The machine.
pub(super) struct Pickle<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<Id>,
    /// Heights of the stack at its marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

impl Pickle<'_> {
    /// Returns the tensors of a pickle, by name, or an error message.
    pub(super) fn read(bytes: &[u8]) -> Result<BTreeMap<String, Stored>, String> {
        let mut machine =
            Pickle { bytes, at: 0, values: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
        let result = machine.run()?;
        machine.tensors(result)
    }

    /// The dictionary `result` as tensors by name.
    fn tensors(&self, result: Id) -> Result<BTreeMap<String, Stored>, String> {
        let Value::Dict(items) = &self.values[result] else {
            return Err(format!("expected a dictionary of tensors by name, found {}", self.values[result].kind()));
        };
        let mut tensors = BTreeMap::new();
        for &(key, value) in items {
            let Value::Text(name) = &self.values[key] else {
                return Err(format!("expected tensors by name, found {} as a name", self.values[key].kind()));
            };
            let Value::Tensor(tensor) = &self.values[value] else {
                let found = self.values[value].kind();
                let shown = shorten(name);
                let hint = match &self.values[value] {
                    Value::Dict(_) => "; save that part alone",
                    _ => "",
                };
                return Err(format!("expected a tensor under every name, found {found} under {shown:?}{hint}"));
            };
            // If names are equal the last counts, as in Python.
            tensors.insert(name.clone(), tensor.clone());
        }
        Ok(tensors)
    }

    fn run(&mut self) -> Result<Id, String> {
        loop {
            let at = self.at;
            match self.byte()? {
                b'.' => return Ok(self.pop()?),
                opcode => self.step(opcode).map_err(|cause| match cause {
                    Fault::Told(cause) => cause,
                    Fault::Cut => format!("it ends within the instruction at byte {at}"),
                    Fault::Unknown => {
                        format!("instruction {opcode:#04x} at byte {at} is none of those that describe tensors")
                    }
                })?,
            }
        }
    }

    fn step(&mut self, opcode: u8) -> Result<(), Fault> {
        match opcode {
            // PROTO, FRAME: nothing to do.
            0x80 => drop(self.take(1)?),
            0x95 => drop(self.take(8)?),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.above_mark()?),
            b'N' => self.push(Value::None),
            0x88 => self.push(Value::Bool(true)),
            0x89 => self.push(Value::Bool(false)),
            // BININT, BININT1, BININT2, LONG1
            b'J' => {
                let value = self.array::<4>()?;
                self.push(Value::Int(i64::from(i32::from_le_bytes(value))));
            }
            b'K' => {
                let [value] = self.array()?;
                self.push(Value::Int(i64::from(value)));
            }
            b'M' => {
                let value = self.array()?;
                self.push(Value::Int(i64::from(u16::from_le_bytes(value))));
            }
            0x8a => {
                let [length] = self.array()?;
                let digits = self.take(usize::from(length))?;
                if digits.len() > 8 {
                    return Err(Fault::Told(format!("a whole number of {} bytes: expected at most 8", digits.len())));
                }
                let negative = digits.last().is_some_and(|last| last & 0x80 != 0);
                let mut whole = [if negative { 0xff } else { 0 }; 8];
                whole[..digits.len()].copy_from_slice(digits);
                self.push(Value::Int(i64::from_le_bytes(whole)));
            }
            b'G' => {
                self.take(8)?;
                self.push(Value::Float);
            }
            // SHORT_BINUNICODE, BINUNICODE, BINUNICODE8, SHORT_BINSTRING, BINSTRING
            0x8c | b'U' => {
                let [length] = self.array()?;
                self.text(u64::from(length))?;
            }
            b'X' | b'T' => {
                let length = self.array()?;
                self.text(u64::from(u32::from_le_bytes(length)))?;
            }
            0x8d => {
                let length = self.array()?;
                self.text(u64::from_le_bytes(length))?;
            }
            // SHORT_BINBYTES, BINBYTES
            b'C' => {
                let [length] = self.array()?;
                self.take(usize::from(length))?;
                self.push(Value::Bytes);
            }
            b'B' => {
                let length = u32::from_le_bytes(self.array()?);
                self.take(length as usize)?;
                self.push(Value::Bytes);
            }
            b')' => self.push(Value::Tuple(Vec::new())),
            0x85..=0x87 => {
                let from = self.stack.len().checked_sub(usize::from(opcode - 0x84)).ok_or_else(Fault::empty)?;
                let items = self.stack.split_off(from);
                self.push(Value::Tuple(items));
            }
            b't' => {
                let items = self.above_mark()?;
                self.push(Value::Tuple(items));
            }
            b']' => self.push(Value::List(Vec::new())),
            b'l' => {
                let items = self.above_mark()?;
                self.push(Value::List(items));
            }
            b'a' => {
                let item = self.pop()?;
                self.append(&[item])?;
            }
            b'e' => {
                let items = self.above_mark()?;
                self.append(&items)?;
            }
            b'}' => self.push(Value::Dict(Vec::new())),
            b'd' => {
                let items = self.above_mark()?;
                self.push(Value::Dict(Vec::new()));
                self.set(&items)?;
            }
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set(&[key, value])?;
            }
            b'u' => {
                let items = self.above_mark()?;
                self.set(&items)?;
            }
            // BINPUT, LONG_BINPUT, MEMOIZE, BINGET, LONG_BINGET
            b'q' => {
                let [index] = self.array()?;
                self.memoize(u64::from(index))?;
            }
            b'r' => {
                let index = u32::from_le_bytes(self.array()?);
                self.memoize(u64::from(index))?;
            }
            0x94 => self.memoize(self.memo.len() as u64)?,
            b'h' => {
                let [index] = self.array()?;
                self.recall(u64::from(index))?;
            }
            b'j' => {
                let index = u32::from_le_bytes(self.array()?);
                self.recall(u64::from(index))?;
            }
            // GLOBAL, STACK_GLOBAL
            b'c' => {
                let name = format!("{}.{}", self.line()?, self.line()?);
                self.push(Value::Global(name));
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                let (Value::Text(module), Value::Text(name)) = (&self.values[module], &self.values[name]) else {
                    return Err(Fault::Told("a class whose name is no text".to_owned()));
                };
                let name = format!("{module}.{name}");
                self.push(Value::Global(name));
            }
            b'Q' => {
                let id = self.pop()?;
                let storage = self.storage(id)?;
                self.push(storage);
            }
            b'R' => {
                let (arguments, function) = (self.pop()?, self.pop()?);
                self.call(function, arguments)?;
            }
            // BUILD: attributes of a dictionary (versions of modules) are ignored; other objects are not built.
            b'b' => {
                self.pop()?;
                let object = self.top()?;
                if !matches!(self.values[object], Value::Dict(_)) {
                    return Err(Fault::Told(format!(
                        "attributes of {}: expected tensors alone",
                        self.values[object].kind()
                    )));
                }
            }
            // NEWOBJ, NEWOBJ_EX, OBJ, INST build objects of classes.
            0x81 | 0x92 => {
                let class =
                    self.stack.len().checked_sub(usize::from(opcode == 0x92) + 2).and_then(|i| self.stack.get(i));
                let class = class.ok_or_else(Fault::empty)?;
                return Err(Fault::object(&self.values[*class].kind()));
            }
            b'o' => {
                let items = self.above_mark()?;
                let class = items.first().ok_or_else(Fault::empty)?;
                return Err(Fault::object(&self.values[*class].kind()));
            }
            b'i' => {
                let name = format!("{}.{}", self.line()?, self.line()?);
                return Err(Fault::object(&Value::Global(name).kind()));
            }
            _ => return Err(Fault::Unknown),
        }
        Ok(())
    }

    /// Computes the result of a call, for the calls that describe tensors.
    fn call(&mut self, function: Id, arguments: Id) -> Result<(), Fault> {
        let (Value::Global(name), Value::Tuple(arguments)) = (&self.values[function], &self.values[arguments]) else {
            return Err(Fault::Told(format!("a call of {}", self.values[function].kind())));
        };
        let wrong = || Fault::Told(format!("{name}: expected a tensor's parts, found others"));
        let made = match (name.as_str(), arguments.as_slice()) {
            ("collections.OrderedDict", []) => Value::Dict(Vec::new()),
            ("torch._utils._rebuild_tensor_v2", [storage, offset, shape, stride, ..]) => {
                let Value::Storage { dtype, key } = &self.values[*storage] else { return Err(wrong()) };
                let offset = self.count(*offset).ok_or_else(wrong)?;
                let (shape, stride) = (self.counts(*shape).ok_or_else(wrong)?, self.counts(*stride).ok_or_else(wrong)?);
                if shape.len() != stride.len() {
                    return Err(wrong());
                }
                Value::Tensor(Stored { storage: key.clone(), dtype: dtype.clone(), offset, shape, stride })
            }
            ("torch._utils._rebuild_parameter", [tensor, ..]) => match &self.values[*tensor] {
                Value::Tensor(_) => {
                    self.stack.push(*tensor);
                    return Ok(());
                }
                _ => return Err(wrong()),
            },
            ("torch.Size", [sides]) => {
                self.stack.push(*sides);
                return Ok(());
            }
            _ => {
                return Err(Fault::Told(format!(
                    "it would call {}, which is not done: expected tensors alone",
                    shorten(name)
                )));
            }
        };
        self.push(made);
        Ok(())
    }

    /// The storage of a persistent identifier: `("storage", class, key, device, elements)`.
    fn storage(&self, id: Id) -> Result<Value, Fault> {
        let wrong = || Fault::Told("a reference that is no storage: expected tensors alone".to_owned());
        let Value::Tuple(parts) = &self.values[id] else { return Err(wrong()) };
        let [kind, class, key, ..] = parts.as_slice() else { return Err(wrong()) };
        let (Value::Text(kind), Value::Global(class), Value::Text(key)) =
            (&self.values[*kind], &self.values[*class], &self.values[*key])
        else {
            return Err(wrong());
        };
        if kind != "storage" || key.contains('/') || key.len() > LONGEST_KEY {
            return Err(wrong());
        }
        let name = class.strip_prefix("torch.").ok_or_else(wrong)?;
        let dtype = dtype(name).ok_or_else(|| Fault::Told(format!("number format {} is not read", shorten(name))))?;
        Ok(Value::Storage { dtype, key: key.clone() })
    }

    fn count(&self, id: Id) -> Option<usize> {
        match self.values[id] {
            Value::Int(value) => usize::try_from(value).ok(),
            _ => None,
        }
    }

    fn counts(&self, id: Id) -> Option<Vec<usize>> {
        match &self.values[id] {
            Value::Tuple(items) if items.len() <= MOST_AXES => items.iter().map(|item| self.count(*item)).collect(),
            _ => None,
        }
    }

    fn append(&mut self, items: &[Id]) -> Result<(), Fault> {
        let list = self.top()?;
        match &mut self.values[list] {
            Value::List(list) => list.extend(items),
            other => return Err(Fault::Told(format!("items for {}", other.kind()))),
        }
        Ok(())
    }

    fn set(&mut self, items: &[Id]) -> Result<(), Fault> {
        let dict = self.top()?;
        let (pairs, rest) = items.as_chunks::<2>();
        match &mut self.values[dict] {
            Value::Dict(dict) if rest.is_empty() => dict.extend(pairs.iter().map(|[key, value]| (*key, *value))),
            other => return Err(Fault::Told(format!("named items for {}", other.kind()))),
        }
        Ok(())
    }

    fn memoize(&mut self, index: u64) -> Result<(), Fault> {
        let top = self.top()?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn recall(&mut self, index: u64) -> Result<(), Fault> {
        let id =
            *self.memo.get(&index).ok_or_else(|| Fault::Told(format!("value {index} is used before it is made")))?;
        self.stack.push(id);
        Ok(())
    }

    fn push(&mut self, value: Value) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn pop(&mut self) -> Result<Id, Fault> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(Fault::empty());
        }
        self.stack.pop().ok_or_else(Fault::empty)
    }

    fn top(&self) -> Result<Id, Fault> {
        self.stack.last().copied().ok_or_else(Fault::empty)
    }

    /// Removes the last mark; returns the values above it.
    fn above_mark(&mut self) -> Result<Vec<Id>, Fault> {
        let from = self.marks.pop().ok_or_else(Fault::empty)?;
        if from > self.stack.len() {
            return Err(Fault::empty());
        }
        Ok(self.stack.split_off(from))
    }

    fn text(&mut self, length: u64) -> Result<(), Fault> {
        let length = usize::try_from(length).map_err(|_| Fault::Cut)?;
        let text =
            std::str::from_utf8(self.take(length)?).map_err(|_| Fault::Told("a name that is not UTF-8".to_owned()))?;
        let text = text.to_owned();
        self.push(Value::Text(text));
        Ok(())
    }

    /// Text up to a line feed.
    fn line(&mut self) -> Result<String, Fault> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|b| *b == b'\n').ok_or(Fault::Cut)?;
        self.at += length + 1;
        Ok(String::from_utf8_lossy(&rest[..length]).into_owned())
    }

    fn byte(&mut self) -> Result<u8, String> {
        let byte = self
            .bytes
            .get(self.at)
            .ok_or_else(|| format!("it ends after {} bytes without its last instruction", self.at))?;
        self.at += 1;
        Ok(*byte)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let (bytes, _) = self.bytes[self.at..].split_first_chunk::<N>().ok_or(Fault::Cut)?;
        self.at += N;
        Ok(*bytes)
    }

    fn take(&mut self, length: usize) -> Result<&[u8], Fault> {
        let (bytes, _) = self.bytes[self.at..].split_at_checked(length).ok_or(Fault::Cut)?;
        self.at += length;
        Ok(bytes)
    }
}

/// Cause of an instruction's failure.
#[derive(Debug)]
enum Fault {
    Told(String),
    Cut,
    Unknown,
}

impl Fault {
    fn empty() -> Fault {
        Fault::Told("an instruction takes more values than there are".to_owned())
    }

    fn object(class: &str) -> Fault {
        Fault::Told(format!(
            "it would build an object of {}, which is not done: expected tensors alone (a state_dict)",
            shorten(class)
        ))
    }
}

impl From<Fault> for String {
    fn from(fault: Fault) -> String {
        match fault {
            Fault::Told(cause) => cause,
            Fault::Cut => "it ends early".to_owned(),
            Fault::Unknown => "an unknown instruction".to_owned(),
        }
    }
}

/// A name for a message: its first characters, printable.
fn shorten(text: &str) -> String {
    text.chars()
        .take(80)
        .flat_map(|c| if c.is_control() { c.escape_default().collect::<Vec<_>>() } else { vec![c] })
        .collect()
}
