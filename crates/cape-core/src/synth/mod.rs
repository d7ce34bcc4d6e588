//! Synthetic stand-ins for licensed data.

mod body;

pub use body::{FACES as BODY_FACES, VERTICES as BODY_VERTICES, synthetic_body};
