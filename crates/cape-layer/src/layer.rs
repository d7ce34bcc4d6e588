use std::path::Path;

use cape_core::{
    SmplModel,
    npy::{Npz, NpzWriter},
};
use ndarray::{Array1, Array2, ArrayD, Dimension, arr1, s};

use crate::{
    Association, BodyFrame, Error, LayerPca, Result, StandardPose,
    error::finite,
    regress::{Features, Motion, Regressor},
};

/// A learned clothing layer: all that predicts clothing for a body in motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// The clothing's triangles, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
    /// The body vertices that clothing follows.
    pub association: Association,
    /// The pose that offsets are measured in.
    pub standard: StandardPose,
    /// The space of offsets.
    pub pca: LayerPca,
    /// What the regression sees of the motion.
    pub features: Features,
    /// Names of the semantic parameters that follow.
    pub parameters: Vec<String>,
    /// From motion and parameters to the space's coordinates.
    pub regressor: Regressor,
}

impl Layer {
    /// Predicts clothing over a body with the unclothed rest shape `[V, 3]`, frame by frame:
    /// `each` gets every frame's vertices, metres, `[n_v, 3]`, as they are made, and ends the
    /// prediction by an error. `parameters` are the semantic ones in the layer's order.
    pub fn predict(
        &self,
        model: &SmplModel,
        shape: &Array2<f64>,
        motion: &Motion,
        parameters: &[f64],
        each: &mut dyn FnMut(usize, Array2<f64>) -> Result<()>,
    ) -> Result<()> {
        if parameters.len() != self.parameters.len() {
            return Err(Error::argument(format!(
                "{} semantic parameters, expected {}: {}",
                parameters.len(),
                self.parameters.len(),
                self.parameters.join(", ")
            )));
        }
        let rows = self.features.rows(motion);
        let size = (self.association.clothing_vertices(), self.association.neighbours(), 3);
        for frame in 0..motion.frames() {
            let row = rows.row(frame);
            let input = Array1::from_iter(row.iter().chain(parameters).copied());
            let code = self.regressor.predict(input.slice(s![..]).insert_axis(ndarray::Axis(0)))?;
            let offsets = self.pca.decode(code.view())?;
            let offsets = offsets
                .into_shape_with_order(size)
                .map_err(|error| Error::argument(error.to_string()))?;
            let pose = motion.poses.row(frame).to_vec();
            let transl = [0, 1, 2].map(|axis| motion.translations[(frame, axis)]);
            let body = BodyFrame::new(model, shape, &pose, transl, &self.standard)?;
            each(frame, self.association.dress(&body, offsets.view())?)?;
        }
        Ok(())
    }

    /// Writes everything as one `.npz`, atomically. The names of the parameters are their UTF-8,
    /// one a line.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let corners: Array1<i64> = self.faces.iter().flatten().map(|&v| i64::from(v)).collect();
        let joints = cape_core::joints::JOINTS;
        let Features { speed, angles, angular_speeds, smoothing } = self.features;
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
        let features = [flag(speed), flag(angles), flag(angular_speeds), smoothing];
        file.add("features", &arr1(&features))?;
        let names: Array1<i64> = self.parameters.join("\n").bytes().map(i64::from).collect();
        file.add("parameter_names", &names)?;
        self.regressor.write(&mut file)?;
        Ok(file.finish()?)
    }

    /// Reads what [`save`](Self::save) wrote, for a body of `body_vertices`.
    ///
    /// # Errors
    /// If an array is missing, does not fit the others, or is not finite; it is named.
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
            let message = format!("face {face:?}, but there are {clothing} clothing vertices");
            return Err(fault(file, "faces", message));
        }
        let pca = LayerPca {
            mean: array(file, "mean")?,
            components: array(file, "components")?,
            variances: array(file, "explained_variance")?,
            total_variance: vector(file, "total_variance", Some(1))?[0],
        };
        let numbers = 3 * clothing * association.neighbours();
        file.expect_shape("mean", pca.mean.shape(), &[Some(numbers)])?;
        file.expect_shape("components", pca.components.shape(), &[None, Some(numbers)])?;
        file.expect_shape("explained_variance", pca.variances.shape(), &[Some(pca.len())])?;
        let numbers = vector(file, "features", Some(4))?;
        let on = |k: usize| numbers[k] != 0.0;
        let features =
            Features { speed: on(0), angles: on(1), angular_speeds: on(2), smoothing: numbers[3] };
        let bytes = naturals(file, "parameter_names")?.into_iter().map(|b| b as u8).collect();
        let names = String::from_utf8(bytes)
            .map_err(|error| fault(file, "parameter_names", error.to_string()))?;
        let regressor = Regressor::read(file)?;
        if regressor.network().sizes().last() != Some(&pca.len()) {
            let message = format!("does not end in {} components", pca.len());
            return Err(fault(file, "sizes", message));
        }
        let standard = StandardPose::Other(vector(file, "standard_pose", None)?.to_vec());
        let parameters = names.lines().map(str::to_owned).collect();
        Ok(Self { faces, association, standard, pca, features, parameters, regressor })
    }
}

fn fault(file: &Npz, field: &str, message: String) -> Error {
    cape_core::Error::field(file.path(), field, message).into()
}

fn array<D: Dimension>(file: &mut Npz, name: &str) -> Result<ndarray::Array<f64, D>> {
    let array: ArrayD<f64> = file.f64(name)?;
    finite(name, &array)?;
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
