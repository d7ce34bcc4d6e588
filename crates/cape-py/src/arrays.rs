//! NumPy arrays as tensors and back.

use std::fmt;

use burn::tensor::{DType, Device, Element, Gradients, Tensor, TensorData};
use ndarray::{Array, ArrayD, ArrayViewD, IxDyn};
use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::{CapeError, argument};

/// Length of one axis that an array must have.
#[derive(Clone, Copy)]
pub(crate) enum Extent {
    /// Any but none.
    Rows,
    Exactly(usize),
    UpTo(usize),
}

impl Extent {
    fn admits(self, length: usize) -> bool {
        match self {
            Self::Rows => length > 0,
            Self::Exactly(expected) => length == expected,
            Self::UpTo(most) => length <= most,
        }
    }
}

impl fmt::Display for Extent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rows => f.write_str("n"),
            Self::Exactly(expected) => write!(f, "{expected}"),
            Self::UpTo(most) => write!(f, "0 to {most}"),
        }
    }
}

/// Argument of NumPy's `float32` or `float64`.
#[derive(Clone, Copy)]
pub(crate) struct Floats<'a, 'py> {
    pub name: &'a str,
    pub array: &'a Bound<'py, PyAny>,
}

impl Floats<'_, '_> {
    /// Precision of the array.
    pub(crate) fn dtype(self) -> PyResult<DType> {
        if self.array.cast::<PyArrayDyn<f32>>().is_ok() {
            return Ok(DType::F32);
        }
        if self.array.cast::<PyArrayDyn<f64>>().is_ok() {
            return Ok(DType::F64);
        }
        let found = match self.array.cast::<PyUntypedArray>() {
            Ok(array) => format!("an array of {}", array.dtype()),
            Err(_) => self.array.get_type().to_string(),
        };
        let name = self.name;
        Err(argument(format!("{name}: {found}, expected an array of float32 or float64")))
    }

    /// The numbers on the host, all finite.
    pub(crate) fn finite<const D: usize>(self, shape: [Extent; D]) -> PyResult<TensorData> {
        self.data(shape, true)
    }

    /// The numbers on the host.
    pub(crate) fn any<const D: usize>(self, shape: [Extent; D]) -> PyResult<TensorData> {
        self.data(shape, false)
    }

    fn data<const D: usize>(self, shape: [Extent; D], finite: bool) -> PyResult<TensorData> {
        let check = finite.then_some(self.name);
        if self.dtype()? == DType::F32 {
            let array = self.array.cast::<PyArrayDyn<f32>>()?.try_readonly()?;
            self.expect(array.shape(), shape)?;
            return copied(&array.as_array(), check, |x| x.is_finite());
        }
        let array = self.array.cast::<PyArrayDyn<f64>>()?.try_readonly()?;
        self.expect(array.shape(), shape)?;
        copied(&array.as_array(), check, |x| x.is_finite())
    }

    fn expect<const D: usize>(self, found: &[usize], shape: [Extent; D]) -> PyResult<()> {
        let fits = |(&length, extent): (&usize, Extent)| extent.admits(length);
        if found.len() == D && found.iter().zip(shape).all(fits) {
            return Ok(());
        }
        let extents = shape.map(|extent| extent.to_string());
        let (name, expected) = (self.name, extents.join(", "));
        Err(argument(format!("{name}: shape {found:?}, expected [{expected}]")))
    }
}

fn copied<T: Element>(
    view: &ArrayViewD<'_, T>,
    name: Option<&str>,
    is_finite: impl Fn(&T) -> bool,
) -> PyResult<TensorData> {
    let values: Vec<T> = match view.as_slice() {
        Some(values) => values.to_vec(),
        None => view.iter().copied().collect(),
    };
    match name.filter(|_| !values.iter().all(is_finite)) {
        Some(name) => Err(argument(format!("{name}: not finite"))),
        None => Ok(TensorData::new(values, view.shape())),
    }
}

/// Tensor of a precision on a device.
pub(crate) fn tensor<const D: usize>(data: TensorData, device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(data, (device, dtype))
}

/// Gradient with respect to a tensor that requires one; zero where nothing depends on it.
pub(crate) fn gradient<const D: usize>(tensor: &Tensor<D>, gradients: &Gradients) -> TensorData {
    match tensor.grad(gradients) {
        Some(gradient) => gradient.into_data(),
        None => tensor.clone().inner().zeros_like().into_data(),
    }
}

/// NumPy array of the numbers, without a copy.
pub(crate) fn array(py: Python<'_>, data: TensorData) -> PyResult<Bound<'_, PyAny>> {
    let shape: Vec<usize> = data.shape().iter().copied().collect();
    match data.dtype() {
        DType::F64 => Ok(shaped::<f64>(data, &shape)?.into_pyarray(py).into_any()),
        _ => Ok(shaped::<f32>(data, &shape)?.into_pyarray(py).into_any()),
    }
}

fn shaped<T: Element>(data: TensorData, shape: &[usize]) -> PyResult<ArrayD<T>> {
    let failed = |error: String| CapeError::new_err(format!("result: {error}"));
    let values = data.try_into_vec::<T>().map_err(|error| failed(format!("{error:?}")))?;
    Array::from_shape_vec(IxDyn(shape), values).map_err(|error| failed(error.to_string()))
}
