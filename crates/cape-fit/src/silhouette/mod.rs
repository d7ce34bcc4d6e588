//! Silhouettes: what an image shows of a person's outline, and how well a surface matches it.

mod distance;
mod energy;
mod mask;
mod soft;
mod surface;

pub use distance::{Nearest, euclidean, manhattan};
pub use energy::{Matched, SilhouetteEnergy, SilhouetteTerms};
pub use mask::Mask;
pub use soft::{SoftRendering, render_softly};
pub use surface::{Rendering, SurfacePoint, render};
