use std::ops::Deref;

use burn::backend::{Flex, tensor::FloatTensor};
use burn::tensor::{DType, Shape};
use burn_flex::{FlexTensor, Layout};

use super::host::{self, HostTensor, host_backend};
use crate::buffer::Buffer;

host_backend!(Flex);

/// Contiguous tensor.
pub(super) struct Values(FlexTensor);

impl Deref for Values {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.0
            .as_slice::<f32>()
            .unwrap_or_else(|| unreachable!("made contiguous, checked to be f32"))
    }
}

impl HostTensor for FlexTensor {
    type Values = Values;

    fn values(self) -> Values {
        Values(self.to_contiguous())
    }

    fn from_buffer(values: Buffer, shape: Shape) -> Self {
        Self::new(values.into(), Layout::contiguous(shape), DType::F32)
    }

    fn update(self, change: impl FnOnce(&mut [f32])) -> Self {
        let mut tensor = self.to_contiguous();
        drop(self);
        let (start, end) = tensor
            .layout()
            .contiguous_offsets()
            .unwrap_or_else(|| unreachable!("made contiguous before"));
        change(&mut tensor.storage_mut::<f32>()[start..end]);
        tensor
    }
}
