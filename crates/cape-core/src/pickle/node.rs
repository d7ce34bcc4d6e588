//! Object graph of a pickle.

use std::ops::Range;

/// A value: scalars in place, other objects by their index in [`super::Pickle`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Item {
    None,
    Bool(bool),
    Int(i64),
    /// An integer of more than 64 bits, whose value is not kept.
    Long,
    Float(f64),
    Node(u32),
}

/// Range of the file, or decoded bytes.
#[derive(Debug)]
pub(super) enum Bytes {
    Source(Range<usize>),
    Owned(Box<[u8]>),
}

#[derive(Debug)]
pub(super) enum Node {
    Bytes(Bytes),
    /// UTF-8, checked on access.
    Text(Bytes),
    List(Vec<Item>),
    Tuple(Box<[Item]>),
    /// Keys and values in insertion order.
    Dict(Vec<(Item, Item)>),
    Set(Vec<Item>),
    /// Index of a class in [`super::Pickle`].
    Class(u32),
    Object(Box<Object>),
}

/// An instance: constructor arguments, and the state set by BUILD.
#[derive(Debug)]
pub(super) struct Object {
    pub(super) class: u32,
    pub(super) arguments: Item,
    pub(super) state: Item,
    pub(super) list: Vec<Item>,
    pub(super) entries: Vec<(Item, Item)>,
}
