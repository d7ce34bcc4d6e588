//! A small software renderer for meshes, and plots, to PNG.
//!
//! No window, no GPU: [`render`] draws [`cape_core::Mesh`]es into an [`Image`] with a depth buffer,
//! smooth or flat shading, textures, a three-light studio, soft shadows and supersampling, on all
//! cores and with the same picture whatever their number. [`silhouette`] draws what a mesh covers, [`contact_sheet`] puts pictures side by side, [`Plot`] draws
//! curves.

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
pub use colour::colour_of;
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
