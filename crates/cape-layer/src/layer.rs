use std::path::Path;

use cape_core::{
    SmplModel,
    npy::{Npz, NpzWriter},
};
use ndarray::{Array1, Array2, ArrayD, Axis, Dimension, arr1};

use crate::{
    Association, BodyFrame, BodyIdentity, Error, Pca, Result,
    regress::{FeatureOptions, FeatureStream, Regressor, SemanticParameters, StreamedFrame},
};
use cape_core::expect_finite;
use cape_core::{BodyMotion, smpl::StandardPose};

/// A learned clothing layer: association, principal components and regressor, which predict the
/// clothing of a body in motion.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_core::smpl::StandardPose;
/// use cape_layer::{Layer, experiment::{LearningOptions, UnposedSet}, regress::TrainingOptions};
///
/// // Learn a patch on the skin of a marching body.
/// let body = synthetic_body();
/// let (set, association) = patch(&body)?;
/// let standard = StandardPose::default();
/// let unposed = UnposedSet::new(&body, &set, &association, &standard)?;
/// let training = TrainingOptions { hidden: vec![4], patience: 10, ..TrainingOptions::default() };
/// let learning = LearningOptions { components: 1, training, ..LearningOptions::default() };
/// let learned = unposed.regression(&[0], &learning, &mut |_| {})?.trained_model;
/// let layer: Layer = unposed.layer(&learned, learning.features);
/// // Predict frame by frame, each as soon as its velocities are known.
/// let shape = body.rest_shape(&[])?;
/// let mut stream = layer.stream(&body, &shape, 30.0, &[0.85])?;
/// assert!(stream.push(&[0.0; 72], [0.0; 3])?.is_none());
/// let first = stream.push(&[0.0; 72], [0.0; 3])?.ok_or("no frame")?;
/// assert_eq!((first.frame, first.clothing.dim()), (0, (3, 3)));
/// # Ok(())
/// # }
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

/// Predicted clothing of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedFrame {
    /// Frame number, from 0.
    pub frame: usize,
    /// Body of the frame.
    pub body: BodyFrame,
    /// Clothing vertices, metres, `[n_v, 3]`.
    pub clothing: Array2<f64>,
}

/// Prediction over a motion that arrives frame by frame: [`Layer::stream`].
#[derive(Debug, Clone)]
pub struct LayerStream<'a> {
    layer: &'a Layer,
    model: &'a SmplModel,
    shape: Array2<f64>,
    semantics: Vec<f64>,
    features: FeatureStream,
}

impl LayerStream<'_> {
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
        Ok(PredictedFrame { frame: frame.frame, body, clothing })
    }
}

impl Layer {
    /// Starts a prediction frame by frame for a body with the unclothed rest shape `[V, 3]`, metres.
    /// `frame_rate` is in frames per second, `parameters` are the semantic parameters in the order of
    /// [`semantics`](Self::semantics).
    pub fn stream<'a>(
        &'a self,
        model: &'a SmplModel,
        shape: &Array2<f64>,
        frame_rate: f64,
        parameters: &[f64],
    ) -> Result<LayerStream<'a>> {
        let semantics = self.semantics.reduced(parameters)?;
        let features = FeatureStream::new(self.features, frame_rate);
        Ok(LayerStream { layer: self, model, shape: shape.clone(), semantics, features })
    }

    /// Predicts clothing over a whole motion. `each` is called with every frame in order; its error
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
        let joints = cape_core::joints::JOINTS;
        let FeatureOptions { speed, angles, angular_speeds, smoothing } = self.features;
        let flag = |on: bool| f64::from(u8::from(on));
        let mut file = NpzWriter::create(path)?;
        file.add("faces", &corners)?;
        file.add("indices", &self.association.indices.mapv(i64::from))?;
        file.add("weights", &self.association.weights)?;
        file.add("standard_pose", &Array1::from_vec(self.standard.angles(joints)))?;
        file.add("mean", &self.pca.mean)?;
        file.add("components", &self.pca.components)?;
        file.add("explained_variance", &self.pca.variances)?;
        file.add("total_variance", &arr1(&[self.pca.total_variance]))?;
        file.add("residual", &arr1(&[self.pca.residual]))?;
        let features = [flag(speed), flag(angles), flag(angular_speeds), smoothing];
        file.add("features", &arr1(&features))?;
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
        let numbers = vector(file, "features", Some(4))?;
        let on = |k: usize| numbers[k] != 0.0;
        let features = FeatureOptions {
            speed: on(0),
            angles: on(1),
            angular_speeds: on(2),
            smoothing: numbers[3],
        };
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
