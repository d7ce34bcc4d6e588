//! Bodies that are part of the program.

use super::HalfBody;
use crate::Result;
use cape_core::{SmplModel, smpl::Gender};

/// Body of a human adult in SMPL's layout, made of MakeHuman's data by `cape body make`; in the public
/// domain (CC0 1.0).
///
/// # Errors
/// If the embedded file is damaged.
///
/// ```
/// use cape_core::smpl::Gender;
/// use cape_synth::{BODY_VERTICES, embedded_body};
///
/// let body = embedded_body(Gender::Female)?;
/// assert_eq!((body.vertices(), body.joints(), body.betas()), (BODY_VERTICES, 24, 10));
/// # Ok::<(), cape_synth::Error>(())
/// ```
pub fn embedded_body(gender: Gender) -> Result<SmplModel> {
    Ok(HalfBody::embedded(gender)?.model())
}

impl HalfBody {
    /// File of the embedded body.
    pub const fn embedded_bytes(gender: Gender) -> &'static [u8] {
        const MALE: &[u8] = include_bytes!("../../data/male.body");
        const FEMALE: &[u8] = include_bytes!("../../data/female.body");
        const NEUTRAL: &[u8] = include_bytes!("../../data/neutral.body");
        match gender {
            Gender::Male => MALE,
            Gender::Female => FEMALE,
            Gender::Neutral => NEUTRAL,
        }
    }

    /// The embedded body.
    ///
    /// # Errors
    /// If the embedded file is damaged.
    pub fn embedded(gender: Gender) -> Result<Self> {
        Self::decode(Self::embedded_bytes(gender))
    }
}
