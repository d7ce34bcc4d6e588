//! Unknowns of a sequence as one vector: translation and pose of each frame, then the shape and the
//! code that all frames share.

use crate::{
    BodyParameters,
    parameters::{BETAS_AT, scale},
};

/// Sizes of the parts of the vector.
#[derive(Debug, Clone, Copy)]
pub(super) struct SequenceLayout {
    pub(super) frames: usize,
    pub(super) betas: usize,
    pub(super) latent: usize,
}

impl SequenceLayout {
    /// Number of unknowns of the frames, which is the place of the first shared one.
    fn shared(self) -> usize {
        self.frames * BETAS_AT
    }

    /// Unknowns `[3 + 72 + betas + latent]` of a frame.
    pub(super) fn frame(self, x: &[f64], frame: usize) -> Vec<f64> {
        [&x[frame * BETAS_AT..][..BETAS_AT], &x[self.shared()..]].concat()
    }

    /// Adds the gradient with respect to the unknowns of a frame.
    pub(super) fn add(self, gradient: &mut [f64], frame: usize, of_frame: &[f64]) {
        let (moving, shared) = of_frame.split_at(BETAS_AT);
        let own = gradient[frame * BETAS_AT..][..BETAS_AT].iter_mut();
        own.zip(moving).for_each(|(g, part)| *g += part);
        gradient[self.shared()..].iter_mut().zip(shared).for_each(|(g, part)| *g += part);
    }

    /// Body of a frame.
    pub(super) fn body(self, x: &[f64], frame: usize) -> BodyParameters {
        BodyParameters::from_vector(&self.frame(x, frame), self.betas)
    }

    /// Shape coefficients.
    pub(super) fn betas(self, x: &[f64]) -> &[f64] {
        &x[self.shared()..][..self.betas]
    }

    /// Latent code.
    pub(super) fn code(self, x: &[f64]) -> &[f64] {
        &x[self.shared() + self.betas..]
    }

    /// Scales of the unknowns in the optimisation.
    pub(super) fn scales(self) -> Vec<f64> {
        let moving = (0..self.shared()).map(|at| scale(at % BETAS_AT));
        moving.chain((0..self.betas + self.latent).map(|at| scale(BETAS_AT + at))).collect()
    }
}

/// Vector of unknowns of bodies of the shape `betas` and a code.
pub(super) fn join(bodies: &[BodyParameters], betas: &[f64], code: &[f64]) -> Vec<f64> {
    let moving = bodies.iter().flat_map(|body| body.transl.iter().chain(&body.pose));
    moving.chain(betas).chain(code).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_share_shape_and_code() {
        let layout = SequenceLayout { frames: 2, betas: 2, latent: 1 };
        let mut bodies =
            [0.5, 0.7].map(|angle| BodyParameters::new(vec![angle; 72], vec![]).unwrap());
        bodies[1].transl = [1.0, 2.0, 3.0];
        let x = join(&bodies, &[8.0, 9.0], &[4.0]);
        assert_eq!((x.len(), layout.scales().len()), (153, 153));
        let second = layout.body(&x, 1);
        assert_eq!(
            (second.transl, second.pose[71], &second.betas[..]),
            ([1.0, 2.0, 3.0], 0.7, &[8.0, 9.0][..])
        );
        assert_eq!((layout.betas(&x), layout.code(&x)), (&[8.0, 9.0][..], &[4.0][..]));
        let mut gradient = vec![0.0; x.len()];
        for frame in 0..2 {
            layout.add(&mut gradient, frame, &layout.frame(&x, frame));
        }
        let expected: Vec<f64> =
            x.iter().enumerate().map(|(at, x)| if at < 150 { *x } else { 2.0 * x }).collect();
        assert_eq!(gradient, expected);
    }
}
