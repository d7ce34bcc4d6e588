//! SMPL: a body mesh as a function of shape and pose.
//!
//! [`SmplModel`] holds the arrays of a body file and evaluates it in `f64` on the host.

mod file;
mod host;
mod model;

pub use host::Posed;
pub use model::SmplModel;

#[cfg(test)]
pub(crate) mod test_model;
