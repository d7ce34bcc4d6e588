//! Synthetic stand-ins for licensed data: a body in SMPL's layout, motions, a procedural wardrobe and
//! captures in the raw layout of the CAPE data set.
//!
//! ```
//! use cape_core::Outfit;
//! use cape_synth::{Wardrobe, synthetic_body};
//!
//! let body = synthetic_body();
//! let wardrobe = Wardrobe::new(&body, 7)?;
//! let worn = wardrobe.fit(wardrobe.outfit_style(0, Outfit::ShortLong, 0));
//! let pose = [0.0; 72];
//! let clothes = wardrobe.displacement(&worn, &pose, 0.0, None)?;
//! let dressed = body.pose(&[1.0, -0.5], &pose, [0.0; 3], Some(&clothes))?;
//! assert_eq!(dressed.vertices.dim(), (6890, 3));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod body;
mod dataset;
mod motion;
pub mod poses;
mod regions;
mod wardrobe;

pub use cape_core::{Error, Result};

pub use body::{FACES as BODY_FACES, VERTICES as BODY_VERTICES, synthetic_body};
pub use dataset::{CaptureGenerator, SequenceGenerator, SynthFrame, SynthSequence, SynthSpec};
pub use motion::{Motion, MotionStyle};
pub use wardrobe::{FittedOutfit, OutfitStyle, Wardrobe};
