//! Tensors from arrays on the host, and back.

use burn::tensor::{Device, Tensor, TensorData};
use ndarray::Array2;

/// The values of a tensor on the host, row-major.
pub fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    let data = tensor.into_data().convert::<f32>();
    data.try_into_vec().unwrap_or_else(|_| unreachable!("converted to f32"))
}

/// An array `[rows, columns]` as a tensor on `device`.
pub fn tensor2(array: Array2<f32>, device: &Device) -> Tensor<2> {
    let shape = [array.nrows(), array.ncols()];
    let values: Vec<f32> = array.into_iter().collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}
