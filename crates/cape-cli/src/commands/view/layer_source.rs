//! Source of the viewer's pictures: a clothing layer over a body in motion.

use std::path::Path;

use cape_core::{BodyMotion, Mesh, SmplModel, motion::MotionOptions};
use cape_data::raw::name_of;
use cape_infer::SKIN_COLOUR;
use cape_layer::Layer;
use cape_synth::{Motion, poses};
use ndarray::Axis;
use serde_json::{Value, json};

use super::wire::{LayerRequest, Person, ViewLayer};
use crate::error::{Error, Result};

/// Largest number of shape coefficients with sliders.
const SHAPES: usize = 10;
/// Duration, seconds, and frame rate of the synthetic motions.
const MOTION: (f64, f64) = (2.0, 30.0);
/// Standard deviations of the training sequences to which sliders of parameters go.
const FARTHEST: f64 = 2.0;
const CLOTH: [f32; 3] = [0.36, 0.50, 0.66];

/// A learned layer, its body, and motions.
pub(super) struct LayerSource {
    title: String,
    layer: Layer,
    model: SmplModel,
    /// Triangles of the body, then of the clothing.
    faces: Vec<[u32; 3]>,
    /// Motions by name.
    motions: Vec<(String, BodyMotion)>,
    /// Indices of the parameters with sliders: those in which training sequences differed, without the
    /// wearer's shape.
    varied: Vec<usize>,
}

impl LayerSource {
    /// Opens a layer on its body; a `motion` of a name is offered before the synthetic ones.
    pub(super) fn open(
        path: &Path,
        model: SmplModel,
        motion: Option<(String, BodyMotion)>,
    ) -> Result<Self> {
        let layer = Layer::load_for(path, &model)?;
        let mut motions: Vec<(String, BodyMotion)> = motion.into_iter().collect();
        for name in Motion::ALL.iter().map(|motion| motion.name()) {
            let file = poses::load_motion(name, MOTION.0, MOTION.1, &MotionOptions::default())?;
            motions.push((name.to_owned(), file.motion_of(&model, &[], None)?));
        }
        let shifted = |face: &[u32; 3]| face.map(|corner| corner + model.vertices() as u32);
        let faces = model.faces.iter().copied().chain(layer.faces.iter().map(shifted)).collect();
        let semantics = &layer.semantics;
        let is_shape = |at: usize| semantics.names()[at].starts_with("beta_");
        let deviations = semantics.deviations();
        let varied =
            (0..deviations.len()).filter(|&at| deviations[at] > 0.0 && !is_shape(at)).collect();
        Ok(Self { title: name_of(path), layer, model, faces, motions, varied })
    }

    pub(super) fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Description of the layer for the page.
    pub(super) fn scene(&self) -> Result<Value> {
        let semantics = &self.layer.semantics;
        let (means, deviations) = (semantics.with(&[])?, semantics.deviations());
        let parameter = |&at: &usize| {
            let reach = FARTHEST * deviations[at];
            json!({
                "name": semantics.names()[at],
                "value": means[at],
                "range": [means[at] - reach, means[at] + reach],
            })
        };
        let motion = |(name, motion): &(String, BodyMotion)| json!({"name": name, "frames": motion.frames(), "fps": motion.frame_rate});
        Ok(json!({
            "title": self.title,
            "kind": "layer",
            "vertices": self.model.vertices() + self.layer.association.clothing_vertices(),
            "faces": self.faces.len(),
            "model": null,
            "sequence": null,
            "layer": {
                "betas": self.model.betas().min(SHAPES),
                "parameters": self.varied.iter().map(parameter).collect::<Vec<_>>(),
                "motions": self.motions.iter().map(motion).collect::<Vec<_>>(),
            },
        }))
    }

    /// Body and predicted clothing, as one mesh.
    pub(super) fn person(&self, request: &LayerRequest) -> Result<Person> {
        let LayerRequest { betas, parameters, motion, frame } = request;
        if betas.iter().chain(parameters).any(|x| !x.is_finite()) {
            return Err(Error::message("betas and parameters must be finite"));
        }
        if parameters.len() != self.varied.len() {
            return Err(Error::message(format!(
                "{} parameters, expected {}",
                parameters.len(),
                self.varied.len()
            )));
        }
        let known = self.motions.iter().find(|(name, _)| name == motion);
        let (_, motion) =
            known.ok_or_else(|| Error::message(format!("unknown motion `{motion}`")))?;
        let semantics = &self.layer.semantics;
        let named: Vec<(String, f64)> = self
            .varied
            .iter()
            .zip(parameters)
            .map(|(&at, &value)| (semantics.names()[at].clone(), value))
            .collect();
        let parameters = semantics.with_wearer(&named, betas)?;
        let shape = self.model.rest_shape(betas)?;
        let stream = self.layer.stream(&self.model, &shape, motion.frame_rate, &parameters)?;
        let predicted = stream.predict_frame(motion, *frame)?;
        let body = predicted.body.posed.iter().map(|at| at.as_vec3().to_array());
        let rows = predicted.clothing.axis_iter(Axis(0));
        let clothing = rows.map(|row| [0, 1, 2].map(|axis| row[axis] as f32));
        let vertices: Vec<[f32; 3]> = body.chain(clothing).collect();
        let (count, skin) = (vertices.len(), self.model.vertices());
        let colour = |vertex: usize| if vertex < skin { SKIN_COLOUR } else { CLOTH };
        Ok(Person {
            layer: ViewLayer::Clothed,
            colours: (0..count).map(colour).collect(),
            distances: vec![0.0; count],
            errors: vec![0.0; count],
            mesh: Mesh { vertices, faces: self.faces.clone() },
        })
    }
}
