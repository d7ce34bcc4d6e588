//! Synthetic data in place of licensed data, for tests, demonstrations and benchmarks.
//!
//! [`embedded_body`] is a human body in SMPL's layout (6890 vertices, 24 joints), male, female or neutral;
//! [`synthetic_body`] is one built from an implicit surface. [`Motion`]s are named joint-angle curves. A [`Wardrobe`] computes procedural clothing as
//! displacements of the rest vertices, with folds that depend on the pose. [`CaptureGenerator`] combines
//! them into capture sequences in the raw layout of the CAPE data set. Everything is determined by a
//! seed.
//!
//! ```
//! use cape_core::Outfit;
//! use cape_synth::{Wardrobe, synthetic_body};
//!
//! let body = synthetic_body();
//! let wardrobe = Wardrobe::new(&body, 7)?;
//! let fitted = wardrobe.fit(wardrobe.outfit_style(0, Outfit::SHORT_LONG, 0)?);
//! let pose = [0.0; 72];
//! let displacement = wardrobe.displacement(&fitted, &pose, 0.0, None)?;
//! let clothed = body.pose(&[1.0, -0.5], &pose, [0.0; 3], Some(&displacement))?;
//! assert_eq!(clothed.vertices.dim(), (6890, 3));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod body;
mod dataset;
mod motion;
pub mod poses;
mod regions;
mod wardrobe;

pub use cape_core::{Error, Result};

pub use body::{
    FACES as BODY_FACES, HalfBody, VERTICES as BODY_VERTICES, embedded_body, synthetic_body,
};
pub use dataset::{
    CaptureGenerator, SequenceGenerator, SubjectGroup, SynthFrame, SynthSequence, SynthSpec,
};
pub use motion::{Motion, MotionStyle};
pub use wardrobe::{FittedOutfit, GarmentLengths, OutfitStyle, Wardrobe, mix_seed};
