//! Sources of clothing that a study compares.

use std::path::Path;

use burn::tensor::Device;
use cape_core::{BodyPose, Outfit};
use cape_data::PackedSet;
use cape_infer::{BodySpec, Run, registration};
use ndarray::{Array2, Array3, Axis};

use crate::{
    console::Console,
    error::{Context, Result},
    priors::PriorArgs,
};

/// Clothing of bodies.
pub(super) enum ClothingSource {
    /// Held-out frames.
    Registrations,
    /// Samples of a run.
    Model(Box<Run>),
}

/// Clothing that is asked of a source.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClothingRequest {
    /// Held-out frame of the clothing, and of the pose unless another is given.
    pub(super) frame: usize,
    /// Pose in place of the frame's, radians.
    pub(super) pose: Option<BodyPose>,
    /// Row of the latent code.
    pub(super) code: usize,
}

impl ClothingSource {
    /// The source called `name`: `registrations`, or a run's directory.
    pub(super) fn open(name: &str, device: &Device) -> Result<Self> {
        if name == "registrations" {
            return Ok(Self::Registrations);
        }
        let run = Run::open(Path::new(name), device)
            .doing(|| format!("{name}: expected `registrations` or a run's directory"))?;
        Ok(Self::Model(Box::new(run)))
    }

    /// Displacements `[1, vertices, 3]`, metres, and the body that wears them.
    pub(super) fn clothing(
        &self,
        set: &PackedSet,
        request: &ClothingRequest,
        codes: &Array2<f32>,
    ) -> Result<(Array3<f32>, BodySpec)> {
        let (registered, mut wearer) = registration(set, request.frame)?;
        wearer.pose = request.pose.unwrap_or(wearer.pose);
        let displacement = match self {
            Self::Registrations => registered,
            Self::Model(run) => {
                let code = codes.select(Axis(0), &[request.code]);
                run.decode_displacements(&code, std::slice::from_ref(&wearer))?
            }
        };
        Ok((displacement, wearer))
    }

    /// Latent codes of `n` samples for each of `outfits`, one outfit after the other; none for
    /// registrations.
    pub(super) fn codes(
        &self,
        prior: &PriorArgs,
        outfits: &[Outfit],
        n: usize,
        seed: u64,
        console: Console,
    ) -> Result<Array2<f32>> {
        match self {
            Self::Registrations => Ok(Array2::zeros((0, 0))),
            Self::Model(run) => prior.codes(run, outfits, n, seed, console),
        }
    }
}
