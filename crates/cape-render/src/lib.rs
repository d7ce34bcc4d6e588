//! Software renderer of meshes, and line plots, to PNG images.
//!
//! [`render`] rasterises [`cape_core::Mesh`]es ([`Object`]) seen by a [`Camera`] into an [`Image`], with
//! depth buffer, smooth or flat shading, textures, three-point lighting, soft shadows and supersampling.
//! It needs neither window nor GPU, uses all cores, and gives the same image for any number of threads.
//! [`portrait`] frames a single object, [`silhouette`] draws the mask of a mesh, [`visible_faces`] the
//! visible triangle of each pixel, [`contact_sheet`] a grid of labelled images, [`Plot`] curves over
//! axes, [`save_animation`] writes an animated PNG.
//!
//! ```
//! use cape_synth::synthetic_body;
//! use cape_render::{Object, Style, View, portrait};
//!
//! let body = synthetic_body().mesh();
//! let style = Style { width: 48, height: 64, ..Style::default() };
//! let image = portrait(Object::new(&body), View::ThreeQuarter, &style)?;
//! assert_eq!((image.width(), image.height()), (48, 64));
//! // The centre shows the body, the corner the background.
//! assert_ne!(image.get(24, 32), image.get(0, 0));
//! # Ok::<(), cape_render::Error>(())
//! ```

mod animation;
mod camera;
mod colour;
mod error;
mod image;
mod image_file;
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
pub use image_file::{ImageFile, ImageFormat};
pub use plot::{Plot, Series};
pub use render::{Background, Object, Shading, Style, portrait, render};
pub use shade::Material;
pub use sheet::{Tile, contact_sheet};
pub use silhouette::silhouette;
pub use text::TextSize;
pub use texture::Texture;
pub use visible::visible_faces;
