//! Silhouettes: masks, distance transforms, rendering, and the silhouette energy `E_S` (CAPE eq. 10).

mod distance;
mod energy;
mod mask;
mod soft;
mod surface;

pub use distance::{DistanceField, euclidean, manhattan};
pub use energy::{SilhouetteEnergy, SilhouetteMatch, SilhouetteTerms};
pub use mask::{Mask, MaskLabel, is_annotation, read_annotated_mask};
pub use soft::{SoftRendering, render_softly};
pub use surface::{Rendering, SurfacePoint, render};
