//! Pictures of fits.

mod curves;
mod pictures;

pub(super) use curves::energies;
pub(super) use pictures::{body, cut, difference, hide, mark, mesh, paper, person_box};
