//! What a pickle is made of.

use std::ops::Range;

/// A value: small ones themselves, others by their number in [`super::Pickle`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Item {
    None,
    Bool(bool),
    Int(i64),
    /// An integer of more than 64 bits; nothing asks for one.
    Long,
    Float(f64),
    Node(u32),
}

/// Bytes in the file, or bytes that had to be decoded.
#[derive(Debug)]
pub(super) enum Bytes {
    Source(Range<usize>),
    Owned(Box<[u8]>),
}

#[derive(Debug)]
pub(super) enum Node {
    Bytes(Bytes),
    /// UTF-8, checked when it is asked for.
    Text(Bytes),
    List(Vec<Item>),
    Tuple(Box<[Item]>),
    /// Keys and values in the order they were set in.
    Dict(Vec<(Item, Item)>),
    Set(Vec<Item>),
    /// A name, by its number in [`super::Pickle`].
    Class(u32),
    Object(Box<Object>),
}

/// An instance: what its class was called with, and the state that was set afterwards.
#[derive(Debug)]
pub(super) struct Object {
    pub(super) class: u32,
    pub(super) arguments: Item,
    pub(super) state: Item,
    pub(super) list: Vec<Item>,
    pub(super) entries: Vec<(Item, Item)>,
}
