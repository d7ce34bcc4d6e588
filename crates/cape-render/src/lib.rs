//! A small software renderer for meshes, and plots, to PNG.
//!
//! No window, no GPU: [`render`] draws [`cape_core::Mesh`]es into an [`Image`] with a depth buffer,
//! smooth or flat shading, textures, a three-light studio, soft shadows and supersampling, on all
//! cores and with the same picture whatever their number. [`silhouette`] draws what a mesh covers, [`contact_sheet`] puts pictures side by side, [`Plot`] draws
//! curves.
//!
//! ```
//! use cape_synth::synthetic_body;
//! use cape_render::{Object, Style, View, portrait};
//!
//! let body = synthetic_body().mesh();
//! let style = Style { width: 48, height: 64, ..Style::default() };
//! let picture = portrait(Object::new(&body), View::ThreeQuarter, &style)?;
//! assert_eq!((picture.width(), picture.height()), (48, 64));
//! // There is a body in the middle, and only the background in the corner.
//! assert_ne!(picture.get(24, 32), picture.get(0, 0));
//! # Ok::<(), cape_render::Error>(())
//! ```

mod animation;
mod camera;
mod colour;
mod error;
mod image;
mod plot;
mod raster;
mod render;
mod shade;
mod sheet;
mod silhouette;
mod text;
mod texture;
mod visible;

pub use animation::save_animation;
pub use camera::{Bounds, Camera, Projection, View};
pub use colour::colormap;
pub use error::{Error, Result};
pub use image::{Image, MAX_SIDE};
pub use plot::{Plot, Series};
pub use render::{Background, Object, Shading, Style, portrait, render};
pub use shade::Material;
pub use sheet::{Tile, contact_sheet};
pub use silhouette::silhouette;
pub use text::TextSize;
pub use texture::Texture;
pub use visible::visible_faces;
