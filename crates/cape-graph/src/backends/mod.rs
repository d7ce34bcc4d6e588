//! Implementations of the operations, one file for each backend.

mod autodiff;
#[cfg(any(feature = "flex", feature = "ndarray"))]
mod cpu;
#[cfg(any(feature = "wgpu", feature = "cuda"))]
mod cubecl;
#[cfg(feature = "flex")]
mod flex;
#[cfg(any(feature = "flex", feature = "ndarray"))]
mod host;
#[cfg(feature = "ndarray")]
mod ndarray;

#[cfg(any(feature = "flex", feature = "ndarray"))]
pub(crate) use cpu::bf16_instructions;

/// Frees the memory that operations on the CPU keep for reuse, and returns its size in bytes.
///
/// Operations on `flex` and `ndarray` keep the memory of dropped tensors of at least 64 KiB, up to
/// 4 GiB in total, for tensors of similar size. Call this after the last of a series of large
/// operations. Scratch memory of the worker threads, which is limited to the largest layer, and the
/// memory of GPU backends are not affected.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::{bias_leaky_relu, release_buffers};
///
/// let device = Device::default();
/// let x = Tensor::<3>::ones([1, 10_000, 8], &device);
/// drop(bias_leaky_relu(x, Tensor::zeros([8], &device), 0.2));
/// release_buffers();
/// ```
pub fn release_buffers() -> usize {
    #[cfg(any(feature = "flex", feature = "ndarray"))]
    return crate::buffer::release();
    #[cfg(not(any(feature = "flex", feature = "ndarray")))]
    0
}
