//! Motions of bodies, and the files that hold them.
//!
//! [`read_motion`] reads any file of SMPL poses that is in use: AMASS, parameters by the names of
//! SMPL-X, AIST++, results of pose estimators (`.npz`, `.npy`, pickles, joblib's files, JSON), MATLAB's
//! files, `.smpl` and tables. It decides which axis points up and what the body cannot use, and says so in
//! [`MotionFile::notes`]. [`BodyMotion`] is a motion in this library's axes.

mod body_motion;
mod clip;
mod content;
mod easymocap;
mod fields;
mod file;
mod foreign;
mod layout;
mod matlab;
mod names;
mod people;
mod person;
mod positions;
mod rotations;
mod smpl_file;
mod table;
#[cfg(test)]
mod tests;
mod up_axis;

pub use body_motion::BodyMotion;
pub use file::{DEFAULT_FRAME_RATE, MotionFile, MotionOptions, Pivot, read_motion, read_motions};
pub use smpl_file::SmplFile;
pub use table::MotionRows;
pub use up_axis::UpAxis;
