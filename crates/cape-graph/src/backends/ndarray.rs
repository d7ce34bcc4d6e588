// Burn deprecates its ndarray backend in favour of flex; it is kept while Burn ships it.
#![allow(deprecated)]

use burn::backend::{NdArray, TensorMetadata, tensor::FloatTensor};
use burn::tensor::{Shape, TensorData};
use burn_ndarray::NdArrayTensor;

use super::host::{self, HostTensor, host_backend};
use crate::buffer::Buffer;

host_backend!(NdArray);

impl HostTensor for NdArrayTensor {
    type Values = Vec<f32>;

    fn values(self) -> Vec<f32> {
        let NdArrayTensor::F32(storage) = self else {
            unreachable!("checked to be f32");
        };
        let array = storage.into_shared();
        if array.is_standard_layout() {
            let (values, offset) = array.into_owned().into_raw_vec_and_offset();
            if offset.unwrap_or(0) == 0 { values } else { values[offset.unwrap_or(0)..].to_vec() }
        } else {
            array.iter().copied().collect()
        }
    }

    fn from_buffer(values: Buffer, shape: Shape) -> Self {
        Self::from_data(TensorData::new(values.to_vec(), shape))
    }

    fn update(self, change: impl FnOnce(&mut [f32])) -> Self {
        let shape = self.shape();
        let mut values = self.values();
        change(&mut values);
        Self::from_data(TensorData::new(values, shape))
    }
}
