use serde::{Deserialize, Serialize};

/// Precision of the matrix products of convolutions and of their gradients.
///
/// Weights, features, sums, normalisations and losses are f32 in either. Only products of at least 16
/// input and output channels are affected, so that displacements enter and leave a network in f32.
///
/// ```
/// use cape_graph::Precision;
///
/// assert_eq!(Precision::default(), Precision::F32);
/// // The instructions of this processor, such as AMX; without any, products are computed in f32.
/// println!("{:?}", Precision::Bf16.instructions());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Factors rounded to bfloat16, sums in f32, on processors with AVX-512 BF16 or AMX; elsewhere as
    /// [`F32`](Self::F32).
    Bf16,
}

impl Precision {
    /// True for [`F32`](Self::F32), the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Name of the instructions that compute products of this precision on this processor; `None` if it
    /// has none, and for [`F32`](Self::F32), which needs no special ones.
    pub fn instructions(self) -> Option<&'static str> {
        match self {
            Self::F32 => None,
            #[cfg(any(feature = "flex", feature = "ndarray"))]
            Self::Bf16 => crate::backends::bf16_instructions(),
            #[cfg(not(any(feature = "flex", feature = "ndarray")))]
            Self::Bf16 => None,
        }
    }
}
