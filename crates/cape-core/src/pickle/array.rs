//! NumPy arrays, scalars and dtypes.

use ndarray::{ArrayD, IxDyn};

use super::{
    class::ClassKind,
    node::{Item, Node, Object},
    value::Value,
};
use crate::{
    Result,
    npy::{NpyElement, NpyHeader, NpyKind, NpyType, read_array},
};

/// Largest nesting depth of views and object arrays.
pub(super) const MAX_DEPTH: usize = 32;
/// Bytes charged to the memory limit for each visited value.
const VISIT: usize = 32;

/// Array as stored in the pickle.
pub(super) enum StoredArray<'a> {
    Numbers {
        dtype: NpyType,
        shape: Vec<usize>,
        fortran: bool,
        /// Permutation of the axes, applied last.
        axes: Option<Vec<usize>>,
        bytes: Value<'a>,
    },
    Objects {
        shape: Vec<usize>,
        fortran: bool,
        elements: Vec<Value<'a>>,
    },
}

impl<'a> Value<'a> {
    /// Array of numbers: a NumPy array or scalar, the value of a chumpy array or view, nested lists of
    /// numbers, or one number (0-dimensional).
    pub fn array<T: NpyElement>(&self) -> Result<ArrayD<T>> {
        self.array_within(MAX_DEPTH)
    }

    pub(super) fn array_within<T: NpyElement>(&self, depth: usize) -> Result<ArrayD<T>> {
        let Some(depth) = depth.checked_sub(1) else {
            return Err(self.error(format!("more than {MAX_DEPTH} nested arrays")));
        };
        // An object referenced several times is visited several times.
        self.charge(VISIT)?;
        if let Some((class, object)) = self.object() {
            return match class.kind {
                ClassKind::NdArray | ClassKind::FromBuffer | ClassKind::JoblibArray => {
                    self.numpy(depth)
                }
                ClassKind::Scalar => self.scalar(object),
                ClassKind::Chumpy => self.chumpy(depth),
                _ => Err(self.error(format!("is {}, expected numbers", self.describe()))),
            };
        }
        match self.item {
            Item::Int(value) => self.number(T::from_int(value.into())),
            Item::Bool(value) => self.number(T::from_int(value.into())),
            Item::Float(value) => self.number(T::from_float(value)),
            _ => match self.items() {
                Some(items) => self.stack(items.iter().map(|&item| self.with(item)), depth),
                None => Err(self.error(format!("is {}, expected numbers", self.describe()))),
            },
        }
    }

    fn number<T: NpyElement>(&self, value: Option<T>) -> Result<ArrayD<T>> {
        let value = value
            .ok_or_else(|| self.error(format!("does not fit {}", std::any::type_name::<T>())))?;
        Ok(ArrayD::from_elem(IxDyn(&[]), value))
    }

    /// Stacks arrays of equal shape along a new first axis.
    fn stack<T: NpyElement>(
        &self,
        elements: impl ExactSizeIterator<Item = Self>,
        depth: usize,
    ) -> Result<ArrayD<T>> {
        let count = elements.len();
        let mut values = Vec::new();
        let mut shape: Option<Vec<usize>> = None;
        for element in elements {
            let array = element.array_within::<T>(depth)?;
            if shape.as_deref().is_some_and(|shape| shape != array.shape()) {
                return Err(self.error("is a list of arrays of different shapes"));
            }
            self.charge(size_of_val(array.as_slice().unwrap_or_default()))?;
            values.extend(array.iter().copied());
            shape.get_or_insert_with(|| array.shape().to_vec());
        }
        let shape: Vec<usize> = std::iter::once(count).chain(shape.unwrap_or_default()).collect();
        ArrayD::from_shape_vec(IxDyn(&shape), values)
            .map_err(|source| self.error(source.to_string()))
    }

    fn numpy<T: NpyElement>(&self, depth: usize) -> Result<ArrayD<T>> {
        match self.stored()? {
            StoredArray::Numbers { dtype, shape, fortran, axes, bytes } => {
                let bytes = bytes.bytes()?;
                let header = NpyHeader { dtype, fortran, shape, data_offset: 0 };
                let count = header.elements_and_bytes().map_or(usize::MAX, |(count, _)| count);
                self.charge(count.saturating_mul(size_of::<T>()))?;
                let array = read_array(&header, &bytes).map_err(|message| self.error(message))?;
                Ok(match axes {
                    None => array,
                    Some(axes) => array.permuted_axes(axes).as_standard_layout().into_owned(),
                })
            }
            StoredArray::Objects { shape, fortran, elements } => {
                match (&shape[..], &elements[..]) {
                    ([], [one]) => one.array_within(depth),
                    _ if fortran => Err(self.error("is an array of objects in Fortran order")),
                    _ => {
                        let flat: ArrayD<T> = self.stack(elements.into_iter(), depth)?;
                        let shape = [&shape, &flat.shape()[1..]].concat();
                        flat.into_shape_with_order(shape).map_err(|e| self.error(e.to_string()))
                    }
                }
            }
        }
    }

    /// Shape and elements of an array of objects, row-major.
    pub fn objects(&self) -> Result<(Vec<usize>, Vec<Self>)> {
        match self.stored()? {
            StoredArray::Objects { shape, elements, .. } => Ok((shape, elements)),
            StoredArray::Numbers { dtype, .. } => {
                Err(self.error(format!("holds `{dtype}`, expected objects")))
            }
        }
    }

    /// Element of a 0-dimensional object array; other values unchanged.
    pub(super) fn unwrap_scalar(&self) -> Result<Self> {
        match self.object() {
            Some((class, _)) if class.kind.is_array() => match self.stored()? {
                StoredArray::Objects { shape, mut elements, .. } if shape.is_empty() => {
                    elements.pop().ok_or_else(|| self.error("is an empty array"))
                }
                _ => Ok(self.clone()),
            },
            _ => Ok(self.clone()),
        }
    }

    fn stored(&self) -> Result<StoredArray<'a>> {
        match self.object() {
            // __setstate__(version, shape, dtype, Fortran order, data); the version may be missing.
            Some((class, object)) if class.kind == ClassKind::NdArray => {
                let state = self.part(object.state, "state").elements();
                let state =
                    state.ok_or_else(|| self.error("is an array without `__setstate__`"))?;
                let ([_, shape, dtype, fortran, data] | [shape, dtype, fortran, data]) = &state[..]
                else {
                    return Err(self.error("is an array with an unknown state"));
                };
                self.assemble(shape, dtype, fortran.int()? != 0, data)
            }
            Some((class, object)) if class.kind == ClassKind::JoblibArray => {
                let data = object.list.first().map(|&data| self.with(data));
                let data = data.ok_or_else(|| self.error("is an array without data"))?;
                if data.object().is_some_and(|(class, _)| class.kind == ClassKind::NdArray) {
                    return data.stored();
                }
                let fortran = self.require("order")?.text()? == "F";
                self.assemble(&self.require("shape")?, &self.require("dtype")?, fortran, &data)
            }
            // _frombuffer(data, dtype, shape, order)
            Some((class, object)) if class.kind == ClassKind::FromBuffer => {
                let arguments = self.part(object.arguments, "arguments").elements();
                match arguments.as_deref() {
                    Some([data, dtype, shape, order]) => {
                        self.assemble(shape, dtype, order.text()? == "F", data)
                    }
                    // C order with permuted axes.
                    Some([data, dtype, shape, _, axes]) => {
                        match self.assemble(shape, dtype, false, data)? {
                            StoredArray::Numbers { dtype, shape, bytes, .. } if !axes.is_none() => {
                                let axes = Some(self.permutation(axes, shape.len())?);
                                Ok(StoredArray::Numbers {
                                    dtype,
                                    shape,
                                    fortran: false,
                                    axes,
                                    bytes,
                                })
                            }
                            stored => Ok(stored),
                        }
                    }
                    _ => Err(self.error("is an array with unknown arguments")),
                }
            }
            _ => Err(self.error(format!("is {}, expected a NumPy array", self.describe()))),
        }
    }

    fn assemble(
        &self,
        shape: &Self,
        dtype: &Self,
        fortran: bool,
        data: &Self,
    ) -> Result<StoredArray<'a>> {
        let shape = self.shape(shape)?;
        let dtype = self.dtype(dtype)?;
        if !dtype.is_object() {
            let bytes = self.part(data.item, "data");
            return Ok(StoredArray::Numbers { dtype, shape, fortran, axes: None, bytes });
        }
        let elements = match data.node() {
            Some(Node::List(items)) => {
                self.charge(2 * items.len() * size_of::<Value>())?;
                items.iter().map(|&item| self.with(item)).collect::<Vec<_>>()
            }
            _ => return Err(self.error("is an object array without a list of elements")),
        };
        let count = shape.iter().try_fold(1usize, |n, &axis| n.checked_mul(axis));
        if count != Some(elements.len()) {
            let message = format!("has shape {shape:?}, but {} objects", elements.len());
            return Err(self.error(message));
        }
        Ok(StoredArray::Objects { shape, fortran, elements })
    }

    /// Permutation of `count` axes.
    pub(super) fn permutation(&self, axes: &Self, count: usize) -> Result<Vec<usize>> {
        let axes = self.shape(axes)?;
        let mut sorted = axes.clone();
        sorted.sort_unstable();
        if sorted.iter().copied().eq(0..count) {
            return Ok(axes);
        }
        Err(self.error(format!("axes {axes:?} are not a permutation of {count} axes")))
    }

    /// Shape of what [`array`](Self::array) reads, without reading it; `None` for what are no
    /// numbers of one shape.
    pub fn numeric_shape(&self) -> Option<Vec<usize>> {
        self.shape_within(MAX_DEPTH)
    }

    fn shape_within(&self, depth: usize) -> Option<Vec<usize>> {
        let depth = depth.checked_sub(1)?;
        self.charge(VISIT).ok()?;
        if let Some((class, _)) = self.object() {
            return match class.kind {
                ClassKind::NdArray | ClassKind::FromBuffer | ClassKind::JoblibArray => {
                    match self.stored().ok()? {
                        StoredArray::Numbers { dtype, mut shape, axes, .. } => {
                            if let Some(axes) = axes {
                                shape = axes.iter().map(|&axis| shape[axis]).collect();
                            }
                            (dtype.size > 0).then_some(shape)
                        }
                        StoredArray::Objects { shape, elements, .. } => {
                            let inner = Self::common_shape(elements.into_iter(), depth)?;
                            Some([shape, inner].concat())
                        }
                    }
                }
                ClassKind::Scalar | ClassKind::Chumpy => {
                    self.array_within::<f64>(depth).ok().map(|array| array.shape().to_vec())
                }
                _ => None,
            };
        }
        match self.item {
            Item::Int(_) | Item::Bool(_) | Item::Float(_) => Some(Vec::new()),
            _ => {
                let items = self.items()?;
                let inner = Self::common_shape(items.iter().map(|&item| self.with(item)), depth)?;
                Some([vec![items.len()], inner].concat())
            }
        }
    }

    fn common_shape(mut elements: impl Iterator<Item = Self>, depth: usize) -> Option<Vec<usize>> {
        let first = elements.next()?.shape_within(depth)?;
        elements.all(|e| e.shape_within(depth).as_ref() == Some(&first)).then_some(first)
    }

    /// Value of a string, of NumPy's strings too.
    pub fn string(&self) -> Result<String> {
        if let Ok(text) = self.text() {
            return Ok(text.into_owned());
        }
        let (dtype, bytes) = match self.object() {
            Some((class, object)) if class.kind == ClassKind::Scalar => {
                let arguments = self.part(object.arguments, "arguments").elements();
                match arguments.as_deref() {
                    Some([dtype, data]) => (self.dtype(dtype)?, data.bytes()?),
                    _ => return Err(self.error("is a scalar with unknown arguments")),
                }
            }
            Some((class, _)) if class.kind.is_array() => match self.stored()? {
                StoredArray::Numbers { dtype, shape, bytes, .. }
                    if shape.iter().all(|&axis| axis == 1) =>
                {
                    return self.decoded(&dtype, &bytes.bytes()?);
                }
                StoredArray::Objects { elements, .. } if elements.len() == 1 => {
                    return elements[0].text().map(std::borrow::Cow::into_owned);
                }
                _ => return Err(self.error("is an array, expected one string")),
            },
            _ => return Err(self.error(format!("is {}, expected a string", self.describe()))),
        };
        self.decoded(&dtype, &bytes)
    }

    fn decoded(&self, dtype: &NpyType, bytes: &[u8]) -> Result<String> {
        self.charge(4 * bytes.len())?;
        dtype.text(bytes).ok_or_else(|| self.error(format!("holds `{dtype}`, expected a string")))
    }

    /// True for an array of booleans.
    pub(super) fn is_mask(&self) -> bool {
        matches!(self.stored(), Ok(StoredArray::Numbers { dtype, .. }) if dtype.kind == NpyKind::Bool)
    }

    pub(super) fn shape(&self, shape: &Self) -> Result<Vec<usize>> {
        let axes = match shape.elements() {
            Some(axes) if axes.len() <= 64 => axes,
            None if matches!(shape.item, Item::Int(_)) => vec![shape.clone()],
            _ => return Err(self.error("has a shape that is not a tuple of at most 64 integers")),
        };
        axes.iter()
            .map(|axis| {
                let length = axis.int()?;
                usize::try_from(length)
                    .map_err(|_| self.error(format!("has an axis of length {length}")))
            })
            .collect()
    }

    fn scalar<T: NpyElement>(&self, object: &Object) -> Result<ArrayD<T>> {
        let arguments = self.part(object.arguments, "arguments").elements();
        let Some([dtype, data]) = arguments.as_deref() else {
            return Err(self.error("is a scalar with unknown arguments"));
        };
        let header = NpyHeader {
            dtype: self.dtype(dtype)?,
            fortran: false,
            shape: Vec::new(),
            data_offset: 0,
        };
        read_array(&header, &data.bytes()?).map_err(|message| self.error(message))
    }

    /// `dtype('f8', align, copy)` with the state `(version, '<', …)`.
    fn dtype(&self, dtype: &Self) -> Result<NpyType> {
        let fault = || self.error("has an unsupported dtype");
        let (class, object) = dtype.object().ok_or_else(fault)?;
        if class.kind != ClassKind::DType {
            return Err(fault());
        }
        let code = self.part(object.arguments, "dtype").elements().ok_or_else(fault)?;
        let code = code.first().ok_or_else(fault)?.text()?;
        let order = match self.part(object.state, "dtype").elements().as_deref() {
            Some([_, order, subtype, names, fields, ..]) => {
                if !(subtype.is_none() && names.is_none() && fields.is_none()) {
                    return Err(self.error("is a record (structured) array; expected numbers"));
                }
                order.text()?
            }
            _ => "|".into(),
        };
        if code.len() > 16 || order.len() > 1 {
            return Err(fault());
        }
        Ok(NpyType::parse(&format!("{order}{code}")))
    }
}
