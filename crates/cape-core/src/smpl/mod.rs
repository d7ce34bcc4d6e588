//! SMPL: a body mesh as a function of shape and pose.

mod model;

pub use model::SmplModel;
