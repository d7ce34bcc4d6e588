//! Transfer of numbers between host arrays and device tensors.

use burn::tensor::{Device, Tensor, TensorData};
use ndarray::Array2;

/// Values of a tensor, row-major, copied to the host.
pub fn to_host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    let data = tensor.into_data().convert::<f32>();
    data.try_into_vec().unwrap_or_else(|_| unreachable!("converted to f32"))
}

/// Tensor `[rows, columns]` on `device` with the values of a host array.
pub fn from_array2(array: Array2<f32>, device: &Device) -> Tensor<2> {
    let shape = [array.nrows(), array.ncols()];
    let values: Vec<f32> = array.into_iter().collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}
