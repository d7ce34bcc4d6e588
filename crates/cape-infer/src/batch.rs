//! Batches on the host and on a device.

use std::ops::Range;

use burn::tensor::{Device, Tensor, TensorData};
use cape_core::tensors::from_array2;
use cape_data::HostBatch;

/// Bodies that pass through the network at a time.
pub const BATCH: usize = 16;

/// `0..count` in consecutive ranges of at most [`BATCH`].
///
/// ```
/// let ranges: Vec<_> = cape_infer::batches(20).collect();
/// assert_eq!(ranges, [0..16, 16..20]);
/// ```
pub fn batches(count: usize) -> impl Iterator<Item = Range<usize>> {
    (0..count).step_by(BATCH).map(move |start| start..(start + BATCH).min(count))
}

/// A batch of frames on a device.
#[derive(Debug, Clone)]
pub struct DeviceBatch {
    /// Normalised displacements, `[batch, vertices, 3]`.
    pub displacement: Tensor<3>,
    /// Pose features, `[batch, 126]`.
    pub pose_feature: Tensor<2>,
    /// One-hot outfit labels, `[batch, outfits]`.
    pub outfit: Tensor<2>,
}

/// Uploads a batch to a device.
pub fn to_device(batch: HostBatch, device: &Device) -> DeviceBatch {
    let HostBatch { displacement, pose_feature, outfit, .. } = batch;
    let [count, vertices, _] = [displacement.dim().0, displacement.dim().1, 3];
    let (values, _) = displacement.into_raw_vec_and_offset();
    DeviceBatch {
        displacement: Tensor::from_data(TensorData::new(values, [count, vertices, 3]), device),
        pose_feature: from_array2(pose_feature, device),
        outfit: from_array2(outfit, device),
    }
}
