//! Bodies that the clothing of a registration is transferred to.

use std::path::Path;

use cape_core::geometry::{SurfaceIndex, SurfaceMesh};
use cape_core::{BodyPose, Mesh};
use cape_infer::{BodySpec, Run};
use ndarray::{Array2, ArrayView2};
use serde::Serialize;

use crate::{
    error::{Error, Result},
    registration::{KnownBodyArgs, RegistrationFile, read_shape},
};

/// Depth under the skin from which on clothing counts as inside, metres.
const INSIDE: f64 = 0.001;
/// Largest distance from the skin at which its closest point is searched, metres.
const REACH: f64 = 0.5;

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

/// Measures of clothing on another body.
#[derive(Debug, Clone, Serialize)]
pub(super) struct ClothingTransfer {
    to: String,
    file: String,
    /// Mean distance of the clothing from the skin at clothing vertices, millimetres.
    distance_mm: f64,
    /// Mean relative change of the lengths of edges between clothing vertices from body to body.
    stretch: f64,
    /// Share of clothing vertices that are more than a millimetre under the skin.
    inside: f64,
    /// The same share on the body that the clothing comes from.
    inside_before: f64,
}

impl ClothingTransfer {
    /// The measures as a line of text.
    pub(super) fn text(&self) -> String {
        format!(
            "on {}: mean change of edge lengths {:.1} %, {:.1} % of clothing vertices inside the body (before {:.1} %)\n",
            self.to,
            100.0 * self.stretch,
            100.0 * self.inside,
            100.0 * self.inside_before
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
        let known = KnownBodyArgs { outfit_worn: Some(cape_core::Outfit::LongLong), minimal: None };
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
        posed(run, &self.minimal, &wearer.pose, Some(&on_clothing(run, worn)))
    }

    /// Measures displacements `[vertices, 3]` on this body and on that of `before`, both in the pose of
    /// the registration.
    pub(super) fn measure(
        &self,
        run: &Run,
        before: &RegistrationFile,
        worn: ArrayView2<'_, f32>,
        file: String,
    ) -> Result<ClothingTransfer> {
        let pose = &before.wearer.pose;
        let betas: Vec<f64> = before.wearer.betas.iter().copied().map(f64::from).collect();
        let source = match &before.minimal {
            Some(minimal) => minimal.clone(),
            None => run.body().rest_shape(&betas)?,
        };
        let worn = on_clothing(run, worn);
        let lengths = |minimal: &Array2<f64>| -> Result<Vec<f64>> {
            let mesh = posed(run, minimal, pose, Some(&worn))?;
            let covered = covered(run);
            let edges = mesh.edges().into_iter();
            let at = |v: u32| glam::Vec3::from(mesh.vertices[v as usize]);
            let edges = edges.filter(|edge| edge.iter().all(|&v| covered[v as usize]));
            Ok(edges.map(|[a, b]| f64::from(at(a).distance(at(b)))).collect())
        };
        let (old, new) = (lengths(&source)?, lengths(&self.minimal)?);
        let stretch = old.iter().zip(&new).map(|(old, new)| (new / old.max(1e-9) - 1.0).abs());
        let stretch = stretch.sum::<f64>() / old.len().max(1) as f64;
        let distance = run.clothing().iter().map(|&v| worn.row(v).dot(&worn.row(v)).sqrt());
        let distance = distance.sum::<f64>() / run.clothing().len().max(1) as f64;
        Ok(ClothingTransfer {
            to: self.name.clone(),
            file,
            distance_mm: 1000.0 * distance,
            stretch,
            inside: inside(run, &self.minimal, pose, &worn)?,
            inside_before: inside(run, &source, pose, &worn)?,
        })
    }
}

fn covered(run: &Run) -> Vec<bool> {
    let mut covered = vec![false; run.body().vertices()];
    run.clothing().iter().for_each(|&vertex| covered[vertex] = true);
    covered
}

/// Displacements of clothing vertices; 0 elsewhere.
fn on_clothing(run: &Run, worn: ArrayView2<'_, f32>) -> Array2<f64> {
    let covered = covered(run);
    Array2::from_shape_fn(worn.dim(), |(vertex, axis)| {
        if covered[vertex] { f64::from(worn[[vertex, axis]]) } else { 0.0 }
    })
}

fn posed(
    run: &Run,
    minimal: &Array2<f64>,
    pose: &BodyPose,
    worn: Option<&Array2<f64>>,
) -> Result<Mesh> {
    let pose = pose.map(f64::from);
    let posed = run.body().pose_shape(minimal, &pose, [0.0; 3], worn)?;
    Ok(run.body().mesh_with(&posed.vertices))
}

/// Share of clothing vertices that are under the skin.
fn inside(run: &Run, minimal: &Array2<f64>, pose: &BodyPose, worn: &Array2<f64>) -> Result<f64> {
    let skin =
        SurfaceIndex::new(&SurfaceMesh::from_mesh("body", &posed(run, minimal, pose, None)?)?);
    let clothed = posed(run, minimal, pose, Some(worn))?;
    let under = |&&vertex: &&usize| {
        let at = glam::DVec3::from_array(clothed.vertices[vertex].map(f64::from));
        skin.closest(at, REACH).is_some_and(|closest| closest.signed_distance < -INSIDE)
    };
    let count = run.clothing().iter().filter(under).count();
    Ok(count as f64 / run.clothing().len().max(1) as f64)
}
