//! Meshes and their files, and the SMPL body with CAPE's additive clothing term.
//!
//! SMPL poses a template mesh of `V` = 6890 vertices by shape coefficients β and joint rotations θ:
//! `M(β, θ) = W(T̄ + B_S(β) + B_P(θ), J(β), θ, 𝒲)`. CAPE adds a clothing displacement `S_clo` to the
//! rest vertices before skinning. [`SmplModel`] evaluates this in `f64` on the host, [`Smpl`] and
//! [`ClothedSmpl`] as differentiable tensor operations on a device.
//!
//! Around the body: [`Mesh`] with its files ([`obj`], [`ply`], [`gltf`], [`usd`]), surface queries
//! ([`geometry`]: closest points, rays), motions of bodies
//! ([`motion`]) and point caches ([`PointCache`]), NumPy arrays ([`npy`]), Python pickles read as data
//! ([`pickle`]), L-BFGS ([`optimise`]), and atomic file output ([`AtomicFile`]).
//!
//! Units are metres and radians; y points up and the body faces +z, as in SMPL.
//!
//! ```
//! use cape_core::Mesh;
//! use cape_synth::synthetic_body;
//!
//! // `SmplModel::load("SMPL_MALE.pkl")` reads an official body; this one is synthetic.
//! let body = synthetic_body();
//! let posed = body.pose(&[1.0, -0.5], &[0.0; 72], [0.0; 3], None)?;
//! assert_eq!(posed.vertices.dim(), (6890, 3));
//!
//! let directory = tempfile::tempdir()?;
//! let path = directory.path().join("body.obj");
//! body.mesh_with(&posed.vertices).save(&path)?;
//! assert_eq!(Mesh::load(&path)?.vertices.len(), 6890);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod atomic;
mod device;
mod error;
mod file_content;
mod file_names;
pub mod geometry;
pub mod gltf;
mod hex;
pub mod joints;
mod keyframes;
mod lock;
mod mesh;
mod mesh_sequence;
pub mod motion;
pub mod npy;
pub mod obj;
pub mod optimise;
mod outfit;
pub mod pickle;
pub mod ply;
mod point_cache;
mod point_cache_writer;
mod progress;
mod sha256;
pub mod smpl;
mod staging;
pub mod tensors;
pub mod usd;
mod uv;

pub use atomic::{AtomicFile, write_atomically};
pub use device::{DEVICES, devices, is_cpu, parse_device};
pub use error::{Error, Result, expect_finite};
pub use file_content::{unexpected_content, unexpected_file};
pub use file_names::{list_files, natural_order};
pub use hex::hex;
pub use joints::BodyPose;
pub use keyframes::{ChosenKeyframes, KeyframeRule, KeyframeSelector};
pub use lock::{DirectoryLock, is_temporary};
pub use mesh::{MESH_EXTENSIONS, Mesh, MeshFile, MeshFormat, MeshReport, MirrorSymmetry};
pub use mesh_sequence::{MeshSequence, MeshSequenceOptions};
pub use motion::BodyMotion;
pub use outfit::{Outfit, OutfitVocabulary};
pub use point_cache::PointCache;
pub use point_cache_writer::{PointCacheFormat, PointCacheWriter};
pub use progress::{ProgressFn, silent};
pub use sha256::sha256_of_file;
pub use smpl::{
    ClothedSmpl, ClothingMask, JointSource, Pose, Smpl, SmplInput, SmplModel, SmplOutput,
};
pub use staging::StagingDirectory;
