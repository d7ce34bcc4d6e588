//! Meshes and their files, the SMPL body, outfits, and a synthetic body and wardrobe.
//!
//! Everything geometric that knows nothing of graphs, networks or training. Units are metres and
//! radians; the y axis points up and the body faces +z, as in SMPL.
//!
//! ```
//! use cape_core::{Outfit, synth::{Wardrobe, synthetic_body}};
//!
//! let body = synthetic_body();
//! let wardrobe = Wardrobe::new(&body, 7)?;
//! let worn = wardrobe.fit(wardrobe.garment(0, Outfit::ShortLong, 0));
//! let pose = [0.0; 72];
//! let clothes = wardrobe.displacement(&worn, &pose, 0.0, None)?;
//! let dressed = body.pose(&[1.0, -0.5], &pose, [0.0; 3], Some(&clothes))?;
//! assert_eq!(dressed.vertices.dim(), (6890, 3));
//!
//! let directory = tempfile::tempdir()?;
//! body.mesh_with(&dressed.vertices).save(directory.path().join("dressed.obj"))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod atomic;
mod device;
mod error;
pub mod gltf;
pub mod joints;
mod mesh;
pub mod npy;
pub mod obj;
pub mod optimise;
mod outfit;
pub mod pickle;
pub mod ply;
pub mod poses;
pub mod smpl;
pub mod synth;

pub use atomic::{AtomicFile, write_atomically};
pub use device::{DEVICES, devices, parse_device};
pub use error::{Error, Result};
pub use mesh::{Mesh, MeshReport};
pub use outfit::Outfit;
pub use poses::BodyPose;
pub use smpl::{
    ClothedSmpl, ClothingMask, JointSource, Pose, Smpl, SmplInput, SmplModel, SmplOutput,
};
