use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

use crate::Error;

/// Outfit: the clothing type `c` of CAPE (§3), named upper garment first.
///
/// ```
/// use cape_core::Outfit;
///
/// let outfit: Outfit = "shortlong".parse()?;
/// assert_eq!(outfit, Outfit::ShortLong);
/// assert!(!outfit.long_sleeves() && outfit.long_legs());
/// assert_eq!(outfit.one_hot(), [1., 0., 0., 0.]);
/// assert_eq!(Outfit::ALL.map(Outfit::index), [0, 1, 2, 3]);
/// assert!("pyjamas".parse::<Outfit>().is_err());
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outfit {
    /// Short sleeves, long trousers.
    ShortLong,
    /// Short sleeves, short trousers.
    ShortShort,
    /// Long sleeves, short trousers.
    LongShort,
    /// Long sleeves, long trousers.
    LongLong,
}

impl Outfit {
    /// All outfits, in one-hot order.
    pub const ALL: [Self; 4] = [Self::ShortLong, Self::ShortShort, Self::LongShort, Self::LongLong];

    /// Index of the outfit in the one-hot label, 0 to 3.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// One-hot label of the outfit, the condition of the network, `[4]`.
    pub const fn one_hot(self) -> [f32; 4] {
        let mut label = [0.0; 4];
        label[self as usize] = 1.0;
        label
    }

    /// Name of the outfit in directory and file names.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ShortLong => "shortlong",
            Self::ShortShort => "shortshort",
            Self::LongShort => "longshort",
            Self::LongLong => "longlong",
        }
    }

    /// True if the upper garment has long sleeves.
    pub const fn long_sleeves(self) -> bool {
        matches!(self, Self::LongShort | Self::LongLong)
    }

    /// True if the lower garment has long legs.
    pub const fn long_legs(self) -> bool {
        matches!(self, Self::ShortLong | Self::LongLong)
    }
}

impl fmt::Display for Outfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Outfit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|outfit| outfit.name() == name).ok_or_else(|| {
            Error::Argument(format!(
                "unknown outfit `{name}`: expected one of shortlong, shortshort, longshort, longlong"
            ))
        })
    }
}
