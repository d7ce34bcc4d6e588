//! The built-in model: clothing of a simulated wardrobe on a human body, trained, with matrices in
//! eight bits.
//!
//! ```
//! use burn::tensor::Device;
//! use cape_infer::BodySpec;
//!
//! let model = cape_weights::pretrained(&Device::default())?;
//! let outfit = model.default_outfit();
//! let wearer = BodySpec { betas: vec![0.5], pose: [0.0; 72], outfit };
//! let dressed = model.dress(&model.sample_for(outfit, 1, 7)?, &[wearer])?;
//! assert_eq!(dressed[0].vertices.len(), 6890);
//! # Ok::<(), cape_infer::Error>(())
//! ```

use burn::tensor::Device;
use cape_infer::{ModelFile, Result, Run};

/// A safetensors file in the layout of [`ModelFile`].
pub const MODEL: &[u8] = include_bytes!("../data/model.safetensors");

/// Name of the model in messages.
pub const NAME: &str = "built-in model";

/// The built-in model on a device.
///
/// ```
/// let model = cape_weights::pretrained(&burn::tensor::Device::default())?;
/// assert_eq!((model.body().vertices(), model.latent()), (6890, 32));
/// # Ok::<(), cape_infer::Error>(())
/// ```
///
/// # Errors
/// If the device cannot hold it.
pub fn pretrained(device: &Device) -> Result<Run> {
    ModelFile::decode(NAME, MODEL)?.open(NAME, device)
}
