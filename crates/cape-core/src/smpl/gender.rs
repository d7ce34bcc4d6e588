use std::{fmt, str::FromStr};

use crate::{Error, Result};

/// Gender of a body model, as SMPL's files have it.
///
/// ```
/// use cape_core::smpl::Gender;
///
/// assert_eq!("neutral".parse::<Gender>()?, Gender::Neutral);
/// assert_eq!(Gender::Female.to_string(), "female");
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Gender {
    /// Male.
    Male,
    /// Female.
    Female,
    /// Neutral: of both together.
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
            _ => Err(Error::Argument(format!("gender `{text}`: expected male, female or neutral"))),
        }
    }
}
