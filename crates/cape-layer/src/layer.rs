use std::path::Path;

use cape_core::{
    SmplModel,
    npy::{Npz, NpzWriter},
};
use ndarray::{Array1, Array2, ArrayD, Axis, Dimension, arr1};

use crate::{
    AssociateOptions, Association, BodyFrame, BodyIdentity, Clearance, Error, InsideShares,
    LayerSet, Pca, Result,
    clearance::CLEARANCE,
    experiment::{LearningOptions, UnposedSet},
    regress::{
        FeatureJoints, FeatureOptions, FeatureStream, Regressor, SemanticParameters, StreamedFrame,
    },
};
use cape_core::expect_finite;
use cape_core::{BodyMotion, geometry::SurfaceMesh, smpl::StandardPose};

/// Largest number of earlier moments whose features a layer uses.
const MOST_HISTORY: f64 = 100.0;

/// A learned clothing layer: association, principal components and regressor, which predict the
/// clothing of a body in motion.
///
/// ```
/// use cape_cloth::{Garment, GarmentKind};
/// use cape_layer::{Layer, LayerOptions, synth::{Design, Exercise}};
/// use cape_synth::synthetic_body;
///
/// // A coarse skirt in twelve frames of a march.
/// let body = synthetic_body();
/// let skirt = Garment { resolution: 0.05, ..Garment::new(GarmentKind::Skirt) };
/// let design = Design { exercises: vec![Exercise::March], frames: 12, ..Design::new(skirt) };
/// let set = design.set(&body, &|_, _| {})?;
/// // Learn it, and predict it over the same motion.
/// let mut options = LayerOptions::default();
/// options.learning.components = Some(3);
/// let layer = Layer::fit(&body, &set, &options)?;
/// let parameters = layer.semantics.with(&[("length".into(), 0.85)])?;
/// let motion = &set.sequences[0].motion;
/// let mut frames = Vec::new();
/// layer.predict(&body, &body.rest_shape(&[])?, motion, &parameters, &mut |frame| {
///     frames.push(frame.clothing);
///     Ok(())
/// })?;
/// assert_eq!((frames.len(), frames[0].dim()), (12, (set.vertices(), 3)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Triangles of the clothing, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
    /// Body vertices that each clothing vertex follows, with their weights (eq. 2).
    pub association: Association,
    /// Standard pose, in which offsets are measured (θ₀ of the paper).
    pub standard: StandardPose,
    /// Principal components of the offsets, `[components, 3 · n_v · n_f]` (§3.2).
    pub pca: Pca,
    /// Motion features that are inputs of the regressor.
    pub features: FeatureOptions,
    /// Semantic parameters that are further inputs: garment sizes and materials.
    pub semantics: SemanticParameters,
    /// Regressor from motion features and semantic parameters to coordinates in the components
    /// (§3.3).
    pub regressor: Regressor,
    /// Body that the layer was learned on, if it is recorded.
    pub body: Option<BodyIdentity>,
}

/// Options of [`Layer::fit`].
#[derive(Debug, Clone, PartialEq)]
pub struct LayerOptions {
    /// Options of the association, which is that of the first frame.
    pub association: AssociateOptions,
    /// Standard pose, in which offsets are measured.
    pub standard: StandardPose,
    /// Options of components and regression.
    pub learning: LearningOptions,
}

impl Default for LayerOptions {
    fn default() -> Self {
        Self {
            association: AssociateOptions::default(),
            standard: StandardPose::A,
            learning: LearningOptions::default(),
        }
    }
}

/// Predicted clothing of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedFrame {
    /// Frame number, from 0.
    pub frame: usize,
    /// Body of the frame.
    pub body: BodyFrame,
    /// Clothing vertices, metres, `[n_v, 3]`.
    pub clothing: Array2<f64>,
    /// Shares of the clothing's surface inside the body, if it is kept out of it.
    pub inside: Option<InsideShares>,
}

/// Prediction over a motion that arrives frame by frame: [`Layer::stream`].
#[derive(Debug, Clone)]
pub struct LayerStream<'a> {
    layer: &'a Layer,
    model: &'a SmplModel,
    shape: Array2<f64>,
    semantics: Vec<f64>,
    features: FeatureStream,
    clearance: Option<Clearance>,
}

impl LayerStream<'_> {
    /// The stream with another least distance of the clothing from the body, metres; `None` leaves the
    /// clothing where it is predicted.
    #[must_use]
    pub fn with_clearance(self, distance: Option<f64>) -> Self {
        let Self { layer, model, .. } = &self;
        let vertices = layer.association.clothing_vertices();
        let clearance = distance.map(|d| Clearance::new(d, model, &layer.faces, vertices));
        Self { clearance, ..self }
    }

    /// Adds the next frame: axis-angles `[3 · joints]`, radians, and a translation, metres. Returns
    /// the frame whose velocities this completes, usually the one before.
    ///
    /// # Errors
    /// If numbers are not finite, or the number of joints differs from the training set's.
    pub fn push(&mut self, pose: &[f64], transl: [f64; 3]) -> Result<Option<PredictedFrame>> {
        let frame = self.features.push(pose, transl)?;
        frame.map(|frame| self.dress(&frame)).transpose()
    }

    /// The next remaining frame after the last one was pushed; `None` at the end.
    pub fn finish(&mut self) -> Result<Option<PredictedFrame>> {
        let frame = self.features.finish()?;
        frame.map(|frame| self.dress(&frame)).transpose()
    }

    /// Clothing of one frame of a whole motion, without the frames that were pushed.
    ///
    /// # Errors
    /// If there is no such frame, or the motion has another number of joints than the training set's.
    pub fn predict_frame(&self, motion: &BodyMotion, frame: usize) -> Result<PredictedFrame> {
        if frame >= motion.frames() {
            return Err(Error::argument(format!(
                "frame {frame}: the motion has {} frames",
                motion.frames()
            )));
        }
        self.dress(&StreamedFrame {
            frame,
            pose: motion.poses.row(frame).to_vec(),
            transl: motion.translation(frame),
            row: self.layer.features.rows(motion).row(frame).to_vec(),
        })
    }

    fn dress(&self, frame: &StreamedFrame) -> Result<PredictedFrame> {
        let Layer { association, pca, regressor, standard, .. } = self.layer;
        let input = Array1::from_iter(frame.row.iter().chain(&self.semantics).copied());
        let code = regressor.predict(input.view().insert_axis(Axis(0)))?;
        let size = (association.clothing_vertices(), association.neighbours(), 3);
        let offsets = pca
            .decode(code.view())?
            .into_shape_with_order(size)
            .map_err(|error| Error::argument(error.to_string()))?;
        let body = BodyFrame::new(self.model, &self.shape, &frame.pose, frame.transl, standard)?;
        let clothing = association.dress(&body, offsets.view())?;
        let (clothing, inside) = match &self.clearance {
            None => (clothing, None),
            Some(clearance) => {
                let (pushed, inside) = clearance.apply(body.posed.clone(), clothing.view());
                (pushed, Some(inside))
            }
        };
        Ok(PredictedFrame { frame: frame.frame, body, clothing, inside })
    }
}

impl Layer {
    /// Learns the clothing of a set on `model`: association in the first frame, principal components and
    /// regression.
    ///
    /// # Errors
    /// If the clothing cannot be associated with the body, there are too few frames for the components,
    /// or an option is out of range.
    pub fn fit(model: &SmplModel, set: &LayerSet, options: &LayerOptions) -> Result<Self> {
        let LayerOptions { association, standard, learning } = options;
        let Some(first) = set.sequences.first() else {
            return Err(Error::argument("layer set: no sequences, expected at least one"));
        };
        let posed = first.body(model, 0, standard)?.posed;
        let body = SurfaceMesh::new("body", posed, model.faces.clone())?;
        let association = association.associate(&body, &set.clothing(0, 0)?)?;
        let unposed = UnposedSet::new(model, set, &association, standard)?;
        Ok(unposed.layer(&unposed.train(learning, &mut |_| {})?, learning.features))
    }

    /// Starts a prediction frame by frame for a body with the unclothed rest shape `[V, 3]`, metres.
    /// `frame_rate` is in frames per second, `parameters` are the semantic parameters in the order of
    /// [`semantics`](Self::semantics). Clothing is kept 2 mm out of the body, unless
    /// [`with_clearance`](LayerStream::with_clearance) says otherwise.
    pub fn stream<'a>(
        &'a self,
        model: &'a SmplModel,
        shape: &Array2<f64>,
        frame_rate: f64,
        parameters: &[f64],
    ) -> Result<LayerStream<'a>> {
        let semantics = self.semantics.reduced(parameters)?;
        let features = FeatureStream::new(self.features, frame_rate);
        let shape = shape.clone();
        let stream =
            LayerStream { layer: self, model, shape, semantics, features, clearance: None };
        Ok(stream.with_clearance(Some(CLEARANCE)))
    }

    /// Predicts clothing over a whole motion, at least 2 mm out of the body. `each` is called with every frame in order; its error
    /// ends the prediction.
    pub fn predict(
        &self,
        model: &SmplModel,
        shape: &Array2<f64>,
        motion: &BodyMotion,
        parameters: &[f64],
        each: &mut dyn FnMut(PredictedFrame) -> Result<()>,
    ) -> Result<()> {
        let mut stream = self.stream(model, shape, motion.frame_rate, parameters)?;
        for frame in 0..motion.frames() {
            let transl = [0, 1, 2].map(|axis| motion.translations[(frame, axis)]);
            if let Some(predicted) = stream.push(&motion.poses.row(frame).to_vec(), transl)? {
                each(predicted)?;
            }
        }
        while let Some(predicted) = stream.finish()? {
            each(predicted)?;
        }
        Ok(())
    }

    /// Writes the layer as one `.npz` archive, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let corners: Array1<i64> = self.faces.iter().flatten().map(|&v| i64::from(v)).collect();
        let standard = self.standard.angles(cape_core::joints::JOINTS);
        let FeatureOptions { speed, angles, angular_speeds, smoothing, joints, history } =
            self.features;
        let flag = |on: bool| f64::from(u8::from(on));
        let mut file = NpzWriter::create(path)?;
        file.add("faces", &corners)?;
        file.add("indices", &self.association.indices.mapv(i64::from))?;
        file.add("weights", &self.association.weights)?;
        file.add("standard_pose", &Array1::from_vec(standard))?;
        file.add("mean", &self.pca.mean)?;
        file.add("components", &self.pca.components)?;
        file.add("explained_variance", &self.pca.variances)?;
        file.add("total_variance", &arr1(&[self.pca.total_variance]))?;
        file.add("residual", &arr1(&[self.pca.residual]))?;
        let features = [speed, angles, angular_speeds].map(flag).into_iter().chain([
            smoothing,
            flag(joints == FeatureJoints::All),
            history as f64,
        ]);
        let features: Vec<f64> = features.collect();
        file.add("features", &Array1::from_vec(features))?;
        self.semantics.write(&mut file)?;
        self.regressor.write(&mut file)?;
        if let Some(BodyIdentity { name, sha256 }) = &self.body {
            file.add_text("body_name", name)?;
            file.add_text("body_sha256", sha256)?;
        }
        Ok(file.finish()?)
    }

    /// Reads a layer that [`save`](Self::save) wrote, for a body of `body_vertices` vertices.
    ///
    /// # Errors
    /// If an array is missing, not finite, or inconsistent with the others; the error has its name.
    pub fn load(path: impl AsRef<Path>, body_vertices: usize) -> Result<Self> {
        let file = &mut Npz::open(path)?;
        let corners = naturals(file, "faces")?;
        let faces = corners.as_chunks::<3>().0.to_vec();
        let weights: Array2<f64> = array(file, "weights")?;
        let indices = Array2::from_shape_vec(weights.dim(), naturals(file, "indices")?)
            .map_err(|error| fault(file, "indices", error.to_string()))?;
        let association = Association::new(indices, weights, body_vertices)?;
        let clothing = association.clothing_vertices();
        if let Some(face) = faces.iter().find(|f| f.iter().any(|&v| v as usize >= clothing)) {
            let message =
                format!("face {face:?}, expected indices below the {clothing} clothing vertices");
            return Err(fault(file, "faces", message));
        }
        let residual = if file.contains("residual") {
            vector(file, "residual", Some(1))?[0]
        } else {
            f64::NAN
        };
        let pca = Pca {
            mean: array(file, "mean")?,
            components: array(file, "components")?,
            variances: array(file, "explained_variance")?,
            total_variance: vector(file, "total_variance", Some(1))?[0],
            residual,
        };
        let numbers = 3 * clothing * association.neighbours();
        file.expect_shape("mean", pca.mean.shape(), &[Some(numbers)])?;
        file.expect_shape("components", pca.components.shape(), &[None, Some(numbers)])?;
        file.expect_shape("explained_variance", pca.variances.shape(), &[Some(pca.latent())])?;
        let features = features(file)?;
        let semantics = SemanticParameters::read(file)?;
        let regressor = Regressor::read(file)?;
        if regressor.network().sizes().last() != Some(&pca.latent()) {
            let message = format!("expected {} outputs, one for each component", pca.latent());
            return Err(fault(file, "sizes", message));
        }
        let standard = StandardPose::Other(vector(file, "standard_pose", None)?.to_vec());
        let body = if file.contains("body_sha256") {
            Some(BodyIdentity { name: file.text("body_name")?, sha256: file.text("body_sha256")? })
        } else {
            None
        };
        Ok(Self { faces, association, standard, pca, features, semantics, regressor, body })
    }

    /// True if `path` is a file that [`save`](Self::save) wrote, by the names of its arrays.
    pub fn is_at(path: impl AsRef<Path>) -> bool {
        let parts = ["semantic_names", "standard_pose", "components", "parameters"];
        Npz::open(path).is_ok_and(|file| parts.iter().all(|part| file.contains(part)))
    }

    /// [`load`](Self::load) for clothing on `model`.
    ///
    /// # Errors
    /// As of `load`, or if the layer was learned on another body.
    pub fn load_for(path: impl AsRef<Path>, model: &SmplModel) -> Result<Self> {
        let path = path.as_ref();
        let layer = Self::load(path, model.vertices())?;
        if let Some(body) = &layer.body {
            body.check(&path.display().to_string(), model)?;
        }
        Ok(layer)
    }
}

/// Options of the features; earlier files have neither the flag of the hands, which were used, nor a
/// history.
fn features(file: &mut Npz) -> Result<FeatureOptions> {
    let numbers = vector(file, "features", None)?;
    let (hands, history) = match numbers.len() {
        4 => (true, 0.0),
        6 => (numbers[4] != 0.0, numbers[5]),
        found => return Err(fault(file, "features", format!("{found} numbers, expected 6"))),
    };
    if !(0.0..=MOST_HISTORY).contains(&history) {
        let message = format!("{history} moments of history, expected 0 to {MOST_HISTORY}");
        return Err(fault(file, "features", message));
    }
    let on = |k: usize| numbers[k] != 0.0;
    Ok(FeatureOptions {
        speed: on(0),
        angles: on(1),
        angular_speeds: on(2),
        smoothing: numbers[3],
        joints: if hands { FeatureJoints::All } else { FeatureJoints::WithoutHands },
        history: history as usize,
    })
}

fn fault(file: &Npz, field: &str, message: String) -> Error {
    cape_core::Error::field(file.path(), field, message).into()
}

fn array<D: Dimension>(file: &mut Npz, name: &str) -> Result<ndarray::Array<f64, D>> {
    let array: ArrayD<f64> = file.f64(name)?;
    expect_finite(name, &array)?;
    array.into_dimensionality().map_err(|error| fault(file, name, error.to_string()))
}

fn vector(file: &mut Npz, name: &str, length: Option<usize>) -> Result<Array1<f64>> {
    let vector: Array1<f64> = array(file, name)?;
    file.expect_shape(name, vector.shape(), &[length])?;
    Ok(vector)
}

fn naturals(file: &mut Npz, name: &str) -> Result<Vec<u32>> {
    let numbers = file.i64(name)?;
    let natural = |&n: &i64| u32::try_from(n).map_err(|error| error.to_string());
    let numbers: Result<Vec<u32>, String> = numbers.iter().map(natural).collect();
    numbers.map_err(|message| fault(file, name, message))
}
