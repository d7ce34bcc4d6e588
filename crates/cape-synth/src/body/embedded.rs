//! Bodies that are part of the program.

use std::{fmt, str::FromStr};

use super::HalfBody;
use crate::{Error, Result};
use cape_core::SmplModel;

/// Sex of the phenotypes that a body is made of.
///
/// ```
/// use cape_synth::Gender;
///
/// assert_eq!("neutral".parse::<Gender>()?, Gender::Neutral);
/// assert_eq!(Gender::Female.to_string(), "female");
/// # Ok::<(), cape_synth::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gender {
    /// Men.
    Male,
    /// Women.
    Female,
    /// Men and women and all between them.
    Neutral,
}

impl fmt::Display for Gender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Male => "male",
            Self::Female => "female",
            Self::Neutral => "neutral",
        })
    }
}

impl FromStr for Gender {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "male" => Ok(Self::Male),
            "female" => Ok(Self::Female),
            "neutral" => Ok(Self::Neutral),
            _ => Err(Error::argument(format!("gender `{text}`: expected male, female or neutral"))),
        }
    }
}

/// Body of a human adult in SMPL's layout, made of MakeHuman's data by `cape body make`; in the public
/// domain (CC0 1.0).
///
/// # Errors
/// If the embedded file is damaged.
///
/// ```
/// use cape_synth::{BODY_VERTICES, Gender, embedded_body};
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
        match gender {
            Gender::Male => include_bytes!("../../data/male.body"),
            Gender::Female => include_bytes!("../../data/female.body"),
            Gender::Neutral => include_bytes!("../../data/neutral.body"),
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
