//! Colours of clothed bodies by garment.

use cape_core::{ClothingMask, Outfit, SmplModel};
use ndarray::ArrayView2;

use crate::garment_labels::{GarmentLabels, GarmentShares, GarmentTables};

/// Colour of uncovered skin, sRGB from 0 to 1.
pub const SKIN_COLOUR: [f32; 3] = [0.83, 0.69, 0.60];
/// Colour of trousers, sRGB from 0 to 1.
pub const TROUSERS_COLOUR: [f32; 3] = [0.27, 0.31, 0.40];
/// Colours of the shirts of other outfits than the paper's.
const OTHER_SHIRTS: [[f32; 3]; 6] = [
    [0.55, 0.47, 0.66],
    [0.38, 0.60, 0.58],
    [0.73, 0.52, 0.56],
    [0.52, 0.55, 0.40],
    [0.45, 0.50, 0.62],
    [0.70, 0.62, 0.52],
];

/// Colours of skin, shirt and trousers, which are told apart by the steps of displacements at hems.
///
/// ```
/// use cape_core::{ClothingMask, Outfit};
/// use cape_infer::{GarmentColours, SKIN_COLOUR};
/// use ndarray::Array2;
///
/// let body = cape_synth::synthetic_body();
/// let mask = ClothingMask::from_weights(&body)?;
/// let displacement = Array2::from_elem((body.vertices(), 3), 0.01);
/// let colours = GarmentColours::new(&body, &mask).of(displacement.view(), Outfit::LONG_LONG);
/// let bare = colours.iter().zip(mask.covered()).filter(|(_, covered)| !**covered);
/// assert!(bare.map(|(colour, _)| colour).all(|colour| *colour == SKIN_COLOUR));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug)]
pub struct GarmentColours(GarmentLabels);

impl GarmentColours {
    /// Colours for displacements of a body at the vertices of a mask.
    pub fn new(body: &SmplModel, mask: &ClothingMask) -> Self {
        Self(GarmentLabels::new(body, mask.covered()))
    }

    /// Tables and numbers by which other programs find the same colours.
    pub fn tables(&self) -> GarmentTables {
        self.0.tables()
    }

    /// Colours of displacements `[V, 3]`, metres, of an outfit: sRGB from 0 to 1, `[V]`.
    pub fn of(&self, displacement: ArrayView2<f32>, outfit: Outfit) -> Vec<[f32; 3]> {
        let shirt = shirt_colour(outfit);
        let colour = |GarmentShares { cloth, trousers }| {
            mix(SKIN_COLOUR, mix(shirt, TROUSERS_COLOUR, trousers), cloth)
        };
        self.0.shares(displacement).into_iter().map(colour).collect()
    }
}

/// Colour of the shirt of an outfit, sRGB from 0 to 1.
pub fn shirt_colour(outfit: Outfit) -> [f32; 3] {
    match outfit {
        Outfit::SHORT_LONG => [0.36, 0.56, 0.67],
        Outfit::SHORT_SHORT => [0.72, 0.42, 0.34],
        Outfit::LONG_SHORT => [0.44, 0.58, 0.43],
        Outfit::LONG_LONG => [0.66, 0.57, 0.36],
        other => OTHER_SHIRTS[(other.stream() % OTHER_SHIRTS.len() as u64) as usize],
    }
}

fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}
