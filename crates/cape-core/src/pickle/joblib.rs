//! Arrays of joblib's files: a description in the pickle, the data behind it.

use super::{
    machine::Machine,
    node::{Bytes, Item, Node},
};
use crate::npy::NpyType;

type Result<T, E = String> = std::result::Result<T, E>;

impl Machine<'_> {
    /// Takes the data of `array`, described by `state`, from the file behind the description: bytes,
    /// after padding, or a pickle if the array is of objects. They become the only element of the
    /// list of `array`.
    pub(super) fn joblib_data(&mut self, array: Item, state: Item) -> Result<()> {
        let shape = match self.field(state, b"shape").and_then(|shape| self.node(shape)) {
            Some(Node::Tuple(axes)) => axes.iter().try_fold(1usize, |count, axis| match axis {
                Item::Int(length) => count.checked_mul(usize::try_from(*length).ok()?),
                _ => None,
            }),
            _ => None,
        };
        let count = shape.ok_or("joblib: an array without a shape")?;
        let dtype = self.field(state, b"dtype").and_then(|dtype| self.joblib_dtype(dtype));
        let dtype = dtype.ok_or("joblib: an array without a dtype")?;
        let data = if dtype.is_object() {
            self.nested()?
        } else {
            if let Some(Item::Int(_)) = self.field(state, b"numpy_array_alignment_bytes") {
                let [padding] = self.bytes()?;
                self.take(padding.into())?;
            }
            let size = dtype.element_bytes().ok_or_else(|| format!("joblib: dtype `{dtype}`"))?;
            let bytes = count.checked_mul(size).ok_or("joblib: an array too large for memory")?;
            let start = self.at;
            self.take(bytes)?;
            self.add(Node::Bytes(Bytes::Source(start..self.at)))?
        };
        if let Some(Node::Object(object)) = self.node_mut(array) {
            object.list = vec![data];
        }
        Ok(())
    }

    fn field(&self, state: Item, key: &[u8]) -> Option<Item> {
        let Some(Node::Dict(entries)) = self.node(state) else { return None };
        let named = |item: Item| self.name(item).is_ok_and(|name| name == key);
        entries.iter().find(|(found, _)| named(*found)).map(|(_, value)| *value)
    }

    /// `dtype('f8', align, copy)` with the state `(version, '<', …)`.
    fn joblib_dtype(&self, dtype: Item) -> Option<NpyType> {
        let Node::Object(object) = self.node(dtype)? else { return None };
        let Node::Tuple(arguments) = self.node(object.arguments)? else { return None };
        let code = self.name(*arguments.first()?).ok()?;
        let order = match self.node(object.state) {
            Some(Node::Tuple(state)) => self.name(*state.get(1)?).ok()?,
            _ => b"|".to_vec(),
        };
        let text = String::from_utf8([order, code].concat()).ok()?;
        Some(NpyType::parse(&text))
    }
}
