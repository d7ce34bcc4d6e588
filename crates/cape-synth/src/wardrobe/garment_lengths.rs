use cape_core::Outfit;

use crate::{Error, Result};

/// Lengths of sleeves and legs of an outfit of the wardrobe.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::GarmentLengths;
///
/// let lengths = GarmentLengths::from_outfit(Outfit::SHORT_LONG)?;
/// assert!(!lengths.long_sleeves && lengths.long_legs);
/// assert!(GarmentLengths::from_outfit("blazerlong".parse()?).is_err());
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GarmentLengths {
    /// True if the upper garment has long sleeves.
    pub long_sleeves: bool,
    /// True if the lower garment has long legs.
    pub long_legs: bool,
}

impl GarmentLengths {
    /// Lengths of one of the paper's four outfits.
    ///
    /// # Errors
    /// If the wardrobe does not have the outfit.
    pub fn from_outfit(outfit: Outfit) -> Result<Self> {
        let (long_sleeves, long_legs) = match outfit {
            Outfit::SHORT_LONG => (false, true),
            Outfit::SHORT_SHORT => (false, false),
            Outfit::LONG_SHORT => (true, false),
            Outfit::LONG_LONG => (true, true),
            _ => {
                let [a, b, c, d] = Outfit::PAPER;
                return Err(Error::Argument(format!(
                    "outfit `{outfit}`: not in the synthetic wardrobe: expected {a}, {b}, {c} or {d}"
                )));
            }
        };
        Ok(Self { long_sleeves, long_legs })
    }
}
