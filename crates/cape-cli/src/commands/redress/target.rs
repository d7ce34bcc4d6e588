//! Bodies that the clothing of a registration is transferred to.

use std::path::Path;

use cape_core::{BodyPose, Mesh};
use cape_eval::clothing::{ClothingTransfer, at_clothing, pose_minimal_shape};
use cape_infer::{BodySpec, Run};
use ndarray::{Array2, ArrayView2};
use serde::Serialize;

use crate::{
    error::{Error, Result},
    registration::{KnownBodyArgs, RegistrationFile, read_shape},
};

/// Body to transfer clothing to.
#[derive(Debug, Clone)]
pub(super) struct TargetBody {
    pub(super) name: String,
    /// Rest vertices without clothing, metres, `[vertices, 3]`.
    minimal: Array2<f64>,
    betas: Vec<f32>,
    /// Pose, if the body is that of a registration.
    pub(super) pose: Option<BodyPose>,
}

/// Measures of clothing on another body, with the names of body and file.
#[derive(Debug, Clone, Serialize)]
pub(super) struct TransferReport {
    to: String,
    file: String,
    #[serde(flatten)]
    measures: ClothingTransfer,
}

impl TransferReport {
    /// The measures as a line of text.
    pub(super) fn text(&self) -> String {
        format!(
            "on {}: mean change of edge lengths {:.1} %, {:.1} % of clothing vertices inside the body (before {:.1} %)\n",
            self.to,
            100.0 * self.measures.stretch,
            100.0 * self.measures.inside,
            100.0 * self.measures.inside_before
        )
    }
}

impl TargetBody {
    /// Shape coefficients `1,-0.5`; a rest shape, `.npy`; or a registration, as the source is given.
    pub(super) fn read(run: &Run, text: &str) -> Result<Self> {
        let body = run.body();
        let betas: Result<Vec<f32>, _> = text.split(',').map(|beta| beta.trim().parse()).collect();
        if let Ok(betas) = betas {
            let double: Vec<f64> = betas.iter().copied().map(f64::from).collect();
            if double.iter().any(|beta| !beta.is_finite()) {
                return Err(Error::message(format!("--to {text}: coefficients must be finite")));
            }
            let minimal = body.rest_shape(&double)?;
            return Ok(Self { name: format!("betas {text}"), minimal, betas, pose: None });
        }
        let path = Path::new(text);
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if path.extension().is_some_and(|extension| extension == "npy") {
            let minimal = read_shape(path, body.vertices())?;
            let fit = body.fit_betas(&minimal, body.betas().min(10))?;
            let betas = fit.betas.iter().map(|&beta| beta as f32).collect();
            return Ok(Self { name, minimal, betas, pose: None });
        }
        // The other body's outfit does not matter.
        let known =
            KnownBodyArgs { outfit_worn: Some(cape_core::Outfit::LONG_LONG), minimal: None };
        let RegistrationFile { wearer, minimal, .. } = RegistrationFile::read(run, text, &known)?;
        let minimal = match minimal {
            Some(minimal) => minimal,
            None => body.rest_shape(&[])?,
        };
        let name = if text.starts_with("frame:") { text.replace(':', " ") } else { name };
        Ok(Self { name, minimal, betas: wearer.betas, pose: Some(wearer.pose) })
    }

    /// The target body in its own pose, if it has one, and the outfit of `before`.
    pub(super) fn body_spec(&self, before: &BodySpec) -> BodySpec {
        BodySpec {
            betas: self.betas.clone(),
            pose: self.pose.unwrap_or(before.pose),
            outfit: before.outfit,
        }
    }

    /// Mesh of the target in its exact shape with displacements `[vertices, 3]`.
    pub(super) fn mesh(
        &self,
        run: &Run,
        wearer: &BodySpec,
        worn: ArrayView2<'_, f32>,
    ) -> Result<Mesh> {
        let displacement = at_clothing(run, worn);
        Ok(pose_minimal_shape(run, &self.minimal, &wearer.pose, Some(&displacement))?)
    }

    /// Measures displacements `[vertices, 3]` on this body and on that of `before`, both in the pose of
    /// the registration.
    pub(super) fn measure(
        &self,
        run: &Run,
        before: &RegistrationFile,
        worn: ArrayView2<'_, f32>,
        file: String,
    ) -> Result<TransferReport> {
        let pose = &before.wearer.pose;
        let betas: Vec<f64> = before.wearer.betas.iter().copied().map(f64::from).collect();
        let source = match &before.minimal {
            Some(minimal) => minimal.clone(),
            None => run.body().rest_shape(&betas)?,
        };
        let measures = ClothingTransfer::measure(run, [&source, &self.minimal], pose, worn)?;
        Ok(TransferReport { to: self.name.clone(), file, measures })
    }
}
