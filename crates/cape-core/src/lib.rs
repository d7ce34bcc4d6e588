//! Meshes and their files, the SMPL body, outfits, and a synthetic body and wardrobe.
//!
//! Everything geometric that knows nothing of graphs, networks or training. Units are metres and
//! radians; the y axis points up and the body faces +z, as in SMPL.

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
