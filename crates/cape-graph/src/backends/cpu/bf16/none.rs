//! Processors without instructions for bfloat16: there are no [`Instructions`] to call these functions with.

use super::{super::kernel::Rows, Instructions, PANEL, Place};

pub(super) fn all() -> Vec<Instructions> {
    Vec::new()
}

pub(super) fn pair_along(by: Instructions, _: &[f32], _: &mut [f32]) {
    match by {}
}

pub(super) fn pair_along_rows(by: Instructions, _: Rows, _: usize, _: usize, _: &mut [f32]) {
    match by {}
}

pub(super) fn pair_across_rows(by: Instructions, _: Rows, _: Place, _: &mut [[f32; PANEL]]) {
    match by {}
}

pub(super) fn transpose(by: Instructions, _: &mut [[f32; PANEL]; PANEL]) {
    match by {}
}

pub(super) fn finish(
    by: Instructions,
    _: Option<&[f32]>,
    _: Option<f32>,
    _: &mut [f32],
    _: usize,
    _: [usize; 2],
) {
    match by {}
}

pub(super) struct Kernel(Instructions);

impl Kernel {
    pub(super) fn new(by: Instructions) -> Self {
        Self(by)
    }

    pub(super) fn block(&self, _: &[f32], _: &[f32], _: usize, _: bool, _: &mut [f32], _: usize) {
        match self.0 {}
    }
}
