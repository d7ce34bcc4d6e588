//! SMPL: a body mesh as a function of shape and pose, unclothed or clothed.
//!
//! [`SmplModel`] holds the arrays of a body file and evaluates the body in `f64` on the host;
//! [`Smpl`] is the same body as differentiable tensor operations on a device; [`ClothedSmpl`] adds
//! CAPE's clothing term.

mod body;
mod clothed;
mod cpu;
mod file;
mod fit;
mod forward;
mod gender;
mod host;
mod mask;
mod model;
mod rodrigues;
mod standard_pose;
mod subject_bodies;

pub use body::{Pose, Smpl, SmplGradient, SmplInput, SmplOutput};
pub use clothed::{ClothedSmpl, JointSource};
pub use file::find_body;
pub use fit::ShapeFit;
pub use gender::Gender;
pub use host::PosedBody;
pub use mask::ClothingMask;
pub use model::SmplModel;
pub use rodrigues::rodrigues;
pub use standard_pose::StandardPose;
pub use subject_bodies::{BODY_FILE, GENDERS_FILE, SubjectBodies, write_genders};

#[cfg(test)]
mod forward_tests;
#[cfg(test)]
pub(crate) mod test_model;
#[cfg(test)]
mod tests;
