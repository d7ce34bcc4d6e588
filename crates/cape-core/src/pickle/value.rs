//! Access to the objects of a pickle.

use std::borrow::Cow;

use super::{
    Pickle,
    class::{Class, ClassKind},
    latin1::latin1,
    node::{Bytes, Item, Node, Object},
};
use crate::{Error, Result};

/// One object of a pickle with its path (`a.b.0`), which errors name.
#[derive(Clone)]
pub struct Value<'a> {
    pub(super) pickle: &'a Pickle,
    pub(super) item: Item,
    name: String,
}

impl<'a> Value<'a> {
    pub(super) fn new(pickle: &'a Pickle, item: Item, name: String) -> Self {
        Self { pickle, item, name }
    }

    /// The object `item`, a component of this one called `part`.
    pub(super) fn part(&self, item: Item, part: &str) -> Self {
        let name = match self.name.as_str() {
            "" => part.to_owned(),
            name => format!("{name}.{part}"),
        };
        Self { pickle: self.pickle, item, name }
    }

    /// The object `item` under the path of this one.
    pub(super) fn with(&self, item: Item) -> Self {
        Self { item, ..self.clone() }
    }

    /// Creates an error about this object.
    pub fn error(&self, message: impl Into<String>) -> Error {
        match self.name.as_str() {
            "" => Error::format(&self.pickle.path, message),
            name => Error::field(&self.pickle.path, name, message),
        }
    }

    pub(super) fn node(&self) -> Option<&'a Node> {
        match self.item {
            Item::Node(number) => self.pickle.nodes.get(number as usize),
            _ => None,
        }
    }

    pub(super) fn object(&self) -> Option<(&'a Class, &'a Object)> {
        match self.node()? {
            Node::Object(object) => Some((&self.pickle.classes[object.class as usize], object)),
            _ => None,
        }
    }

    /// Qualified class name of an instance, e.g. `numpy.ndarray`.
    pub fn class(&self) -> Option<&'a str> {
        self.object().map(|(class, _)| class.name.as_str())
    }

    /// True for Python's `None`.
    pub fn is_none(&self) -> bool {
        self.item == Item::None
    }

    /// Entry `key` of a dictionary, or attribute `key` of an object.
    pub fn get(&self, key: &str) -> Option<Self> {
        let entries = self.entries()?;
        // A later entry replaces an earlier one of the same key.
        let (_, item) =
            entries.iter().rev().find(|(found, _)| self.raw(*found) == Some(key.as_bytes()))?;
        Some(self.part(*item, key))
    }

    /// [`get`](Self::get), with an error if `key` is missing.
    pub fn require(&self, key: &str) -> Result<Self> {
        if self.entries().is_none() {
            return Err(self.error(format!("is {}, expected a dictionary", self.describe())));
        }
        self.get(key).ok_or_else(|| self.part(Item::None, key).error("missing"))
    }

    /// Keys of a dictionary, or names of the attributes of an object.
    pub fn keys(&self) -> Vec<String> {
        let entries = self.entries().into_iter().flatten();
        entries.filter_map(|(key, _)| Some(self.part(*key, "key").text().ok()?.into())).collect()
    }

    /// Entries of a dictionary with their keys as text; `None` for anything else. Keys that are
    /// neither strings nor integers are left out.
    pub fn items_by_name(&self) -> Option<Vec<(String, Self)>> {
        match self.node()? {
            Node::Dict(_) => {}
            Node::Object(object)
                if self.pickle.classes[object.class as usize].kind == ClassKind::Dict => {}
            _ => return None,
        }
        let entries = self.entries()?;
        self.charge(entries.len().saturating_mul(size_of::<(String, Self)>())).ok()?;
        let named = entries.iter().filter_map(|&(key, item)| {
            let name = self.with(key).key()?;
            let value = self.part(item, &name);
            Some((name, value))
        });
        Some(named.collect())
    }

    /// Text of a key.
    fn key(&self) -> Option<String> {
        match self.item {
            Item::Int(number) => Some(number.to_string()),
            _ => match self.string() {
                Ok(text) => Some(text),
                Err(_) => self.array::<i64>().ok()?.iter().next().map(ToString::to_string),
            },
        }
    }

    fn entries(&self) -> Option<&'a [(Item, Item)]> {
        match self.node()? {
            Node::Dict(entries) => Some(entries),
            Node::Object(object) => match self.pickle.classes[object.class as usize].kind {
                ClassKind::Dict => Some(&object.entries),
                _ => match self.part(object.state, "state").node()? {
                    Node::Dict(entries) => Some(entries),
                    // The state of classes with slots: a dictionary and the slots.
                    Node::Tuple(parts) => match self.part(*parts.first()?, "state").node()? {
                        Node::Dict(entries) => Some(entries),
                        _ => None,
                    },
                    _ => None,
                },
            },
            _ => None,
        }
    }

    pub(super) fn items(&self) -> Option<&'a [Item]> {
        match self.node()? {
            Node::List(items) => Some(items),
            Node::Tuple(items) => Some(items),
            _ => None,
        }
    }

    /// Elements of a list or tuple.
    pub fn elements(&self) -> Option<Vec<Self>> {
        let items = self.items()?;
        Some(items.iter().enumerate().map(|(at, &item)| self.part(item, &at.to_string())).collect())
    }

    /// Value of an integer, or of a boolean as 0 or 1.
    pub fn int(&self) -> Result<i64> {
        match self.item {
            Item::Int(value) => Ok(value),
            Item::Bool(value) => Ok(value.into()),
            _ => Err(self.error(format!("is {}, expected an integer", self.describe()))),
        }
    }

    /// Value of a string; byte strings of Python 2 are decoded as Latin-1.
    pub fn text(&self) -> Result<Cow<'a, str>> {
        match self.node() {
            Some(Node::Text(bytes)) => std::str::from_utf8(self.slice(bytes))
                .map(Cow::Borrowed)
                .map_err(|_| self.error("is not valid UTF-8")),
            Some(Node::Bytes(bytes)) => {
                let bytes = self.slice(bytes);
                Ok(match std::str::from_utf8(bytes) {
                    Ok(text) if bytes.is_ascii() => Cow::Borrowed(text),
                    _ => {
                        self.charge(2 * bytes.len())?;
                        bytes.iter().map(|&byte| char::from(byte)).collect()
                    }
                })
            }
            _ => Err(self.error(format!("is {}, expected a string", self.describe()))),
        }
    }

    /// Value of a byte string in any of its encodings.
    pub(super) fn bytes(&self) -> Result<Cow<'a, [u8]>> {
        if let Some(Node::Bytes(bytes)) = self.node() {
            return Ok(Cow::Borrowed(self.slice(bytes)));
        }
        if let Some(Node::Text(_)) = self.node() {
            return self.latin1();
        }
        if let Some((class, object)) = self.object() {
            let arguments = self.part(object.arguments, "arguments").elements();
            let first = arguments.and_then(|arguments| arguments.into_iter().next());
            match (class.kind, first) {
                // Python 3 writes bytes for protocols 0 to 2 as a string and a call of `encode`.
                (ClassKind::Encode | ClassKind::Bytes, Some(first)) => match first.node() {
                    Some(Node::Bytes(bytes)) => return Ok(Cow::Borrowed(self.slice(bytes))),
                    Some(Node::Text(_)) => return first.latin1(),
                    Some(Node::Object(inner)) if class.kind == ClassKind::Bytes => {
                        let is_encode =
                            self.pickle.classes[inner.class as usize].kind == ClassKind::Encode;
                        if is_encode {
                            return first.bytes();
                        }
                    }
                    _ => {}
                },
                (ClassKind::Bytes, None) => return Ok(Cow::Borrowed(&[])),
                _ => {}
            }
        }
        Err(self.error(format!("is {}, expected bytes", self.describe())))
    }

    fn latin1(&self) -> Result<Cow<'a, [u8]>> {
        let text = self.raw(self.item).unwrap_or_default();
        self.charge(text.len())?;
        latin1(text)
            .map(Cow::Owned)
            .ok_or_else(|| self.error("holds characters that are not Latin-1"))
    }

    fn raw(&self, item: Item) -> Option<&'a [u8]> {
        let Item::Node(number) = item else { return None };
        match self.pickle.nodes.get(number as usize)? {
            Node::Text(bytes) | Node::Bytes(bytes) => Some(self.slice(bytes)),
            _ => None,
        }
    }

    fn slice(&self, bytes: &'a Bytes) -> &'a [u8] {
        match bytes {
            Bytes::Source(range) => &self.pickle.source[range.clone()],
            Bytes::Owned(bytes) => bytes,
        }
    }

    /// Deducts `bytes` from the limit of what may be copied out of the file.
    pub(super) fn charge(&self, bytes: usize) -> Result<()> {
        let allowance = &self.pickle.allowance;
        match allowance.get().checked_sub(bytes as u64) {
            Some(left) => {
                allowance.set(left);
                Ok(())
            }
            None => Err(self.error(format!(
                "{bytes} more bytes exceed the memory limit for a file of {} bytes",
                self.pickle.source.len()
            ))),
        }
    }

    /// Kind of the object, for error messages.
    pub(super) fn describe(&self) -> String {
        match self.item {
            Item::None => "None".into(),
            Item::Bool(_) => "a boolean".into(),
            Item::Int(_) | Item::Long => "an integer".into(),
            Item::Float(_) => "a number".into(),
            Item::Node(_) => match self.node() {
                None | Some(Node::Bytes(_)) => "bytes".into(),
                Some(Node::Text(_)) => "a string".into(),
                Some(Node::List(_)) => "a list".into(),
                Some(Node::Tuple(_)) => "a tuple".into(),
                Some(Node::Dict(_)) => "a dictionary".into(),
                Some(Node::Set(_)) => "a set".into(),
                Some(Node::Class(_)) => "a class".into(),
                Some(Node::Object(object)) => {
                    format!("a `{}`", self.pickle.classes[object.class as usize].name)
                }
            },
        }
    }
}
