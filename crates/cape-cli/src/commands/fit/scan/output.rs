//! Files of a fit to a scan.

use std::path::{Path, PathBuf};

use cape_core::{
    Mesh,
    gltf::{self, Keyframe, SkinnedMesh},
    npy::write_npy,
    ply,
};
use cape_fit::scan::{
    FrameLocation, FreeFormSurface, Registration, RemovedElements, Scan, ScanDistance, ScanFit,
    ScanFitter, UpAxis,
};
use cape_infer::{Run, write_json};
use glam::DVec3;
use ndarray::{Array1, Array2};
use serde::Serialize;

use super::{FitScanArgs, picture};
use crate::{error::Result, files};

/// A fit and what it was made from.
pub(super) struct ScanOutput<'a> {
    pub(super) run: &'a Run,
    pub(super) fitter: &'a ScanFitter,
    pub(super) scan: &'a Scan,
    pub(super) fit: ScanFit,
    /// Fitted surface, `[V]`, metres.
    pub(super) surface: Vec<DVec3>,
    pub(super) free: Option<FreeFormSurface>,
    pub(super) up: UpAxis,
}

/// Result of the command.
#[derive(Debug, Serialize)]
pub(super) struct OutputPaths {
    pub(super) out: PathBuf,
    pub(super) fit: ScanFit,
    pub(super) free: Option<FreeFormOutput>,
    /// Points and triangles of the scan that were left out.
    pub(super) removed: RemovedElements,
    /// Length of the scan's unit, metres.
    pub(super) scale: f64,
    pub(super) seconds: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct FreeFormOutput {
    /// File of the frame in the raw tree.
    pub(super) registration: PathBuf,
    pub(super) distance: ScanDistance,
    pub(super) moved_mm: f64,
    curves: Vec<Vec<f64>>,
}

impl ScanOutput<'_> {
    pub(super) fn write(self, command: &FitScanArgs, seconds: f64) -> Result<OutputPaths> {
        let out = &command.output.out;
        files::create_dir(out)?;
        let body = self.fitter.body();
        let minimal = self.fitter.minimal(&self.fit)?;
        let parameters = &self.fit.parameters;
        let bare = body.pose_shape(&minimal, &parameters.pose, parameters.transl, None)?;
        ply::write(out.join("bare.ply"), &body.mesh_with(&bare.vertices), None)?;
        let clothed = mesh(&self.surface, &body.faces);
        ply::write(out.join("clothed.ply"), &clothed, None)?;
        let single = |values: &[f64]| Array1::from_iter(values.iter().map(|&x| x as f32));
        write_npy(out.join("code.npy"), &single(&self.fit.code))?;
        write_npy(out.join("pose.npy"), &single(&parameters.pose))?;
        write_npy(out.join("minimal.npy"), &minimal)?;

        let free = match &self.free {
            Some(free) => Some(self.write_registration(command, &minimal, free)?),
            None => None,
        };
        let last = self.free.as_ref().map_or(&self.surface, |free| &free.vertices);
        self.write_gltf(&out.join("clothed.glb"), &minimal, last)?;
        let surfaces = [Some(&self.surface), self.free.as_ref().map(|free| &free.vertices)];
        let surfaces: Vec<&[DVec3]> = surfaces.into_iter().flatten().map(Vec::as_slice).collect();
        let bare_mesh = body.mesh_with(&bare.vertices);
        let sheet = picture::draw(self.scan, &bare_mesh, &surfaces, parameters, self.up)?;
        sheet.save(out.join("fit.png"))?;
        let (removed, scale) = (self.scan.removed(), self.scan.scale());
        let written =
            OutputPaths { out: out.clone(), fit: self.fit, free, removed, scale, seconds };
        write_json(&out.join("fit.json"), &written)?;
        Ok(written)
    }

    fn write_registration(
        &self,
        command: &FitScanArgs,
        minimal: &Array2<f64>,
        free: &FreeFormSurface,
    ) -> Result<FreeFormOutput> {
        let body = self.run.body();
        let displaced = mesh(&free.vertices, &body.faces);
        ply::write(command.output.out.join("displaced.ply"), &displaced, None)?;
        let parameters = &self.fit.parameters;
        let registration = Registration { body, minimal, parameters, vertices: &free.vertices };
        let place = FrameLocation {
            subject: command.subject.clone(),
            outfit: self.fit.outfit,
            sequence: command.sequence.clone(),
            number: command.frame,
        };
        let root = command.raw.clone().unwrap_or_else(|| command.output.out.join("raw"));
        Ok(FreeFormOutput {
            registration: registration.write(&root, &place, self.run.clothing())?,
            distance: free.distance,
            moved_mm: free.moved,
            curves: free.curves.clone(),
        })
    }

    /// Writes the surface in its pose with skeleton and skinning weights.
    fn write_gltf(&self, path: &Path, minimal: &Array2<f64>, vertices: &[DVec3]) -> Result {
        let body = self.fitter.body();
        let parameters = &self.fit.parameters;
        let frame = Registration { body, minimal, parameters, vertices }.frame()?;
        let figure = SkinnedMesh {
            name: "scan",
            body,
            rest: frame.v_cano,
            joints: body.rest_joints(minimal)?,
            colours: None,
            texture: None,
            targets: Vec::new(),
        };
        let keyframe = Keyframe {
            time: 0.0,
            pose: parameters.pose.clone(),
            transl: parameters.transl,
            offset: Some(body.pose_offsets(&parameters.pose)?),
        };
        Ok(gltf::write(path, &figure, &[keyframe])?)
    }
}

pub(super) fn mesh(vertices: &[DVec3], faces: &[[u32; 3]]) -> Mesh {
    let vertices = vertices.iter().map(|v| v.as_vec3().to_array()).collect();
    Mesh { vertices, faces: faces.to_vec() }
}
