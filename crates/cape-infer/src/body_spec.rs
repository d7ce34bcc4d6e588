//! A trained model's clothes on posed bodies (CAPE eq. 3–4), and clothes back to codes.

use burn::tensor::{Tensor, TensorData};
use cape_core::{BodyPose, Mesh, Outfit, Pose, SmplInput};
use ndarray::{Array2, Array3, Axis};

use crate::{DeviceBatch, Error, Result, Run, to_device};
use cape_core::{
    joints::pose_features,
    tensors::{from_array2, to_host},
};
use cape_data::PackedSet;

/// Bodies dressed at a time.
const BATCH: usize = 16;

/// Whom clothes are made for.
///
/// See [`Run`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct BodySpec {
    /// Shape coefficients; missing ones are zero.
    pub betas: Vec<f32>,
    /// Axis-angles of the 24 joints, radians.
    pub pose: BodyPose,
    /// What is worn.
    pub outfit: Outfit,
}

impl Run {
    /// Bodies in the clothes that `codes` `[n, latent]` stand for, one for each of `wearers`.
    ///
    /// ```no_run
    /// # use cape_infer::{Run, BodySpec};
    /// # use cape_core::Outfit;
    /// # use cape_synth::poses;
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let run = Run::open("run".as_ref(), &burn::tensor::Device::default())?;
    /// let pose = poses::poses("walk")?[0].1;
    /// let wearer = BodySpec { betas: vec![1.0, -0.5], pose, outfit: Outfit::LongLong };
    /// run.dress(&run.sample_codes(1, 7), &[wearer])?[0].save("dressed.obj")?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn dress(&self, codes: &Array2<f32>, wearers: &[BodySpec]) -> Result<Vec<Mesh>> {
        let worn = self.decode_displacements(codes, wearers)?;
        self.pose_clothed(&worn, wearers)
    }

    /// Displacements in metres that `codes` `[n, latent]` stand for under the poses and outfits of
    /// `wearers`: `[n, vertices, 3]`, at all vertices.
    ///
    /// # Errors
    /// If sizes disagree.
    pub fn decode_displacements(
        &self,
        codes: &Array2<f32>,
        wearers: &[BodySpec],
    ) -> Result<Array3<f32>> {
        let (poses, outfits) = poses_and_outfits(wearers);
        self.decode(codes, &poses, &outfits)
    }

    /// Bodies in given clothes: displacements `[n, vertices, 3]` in metres, of which those at
    /// clothing vertices apply; joints follow the body.
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn pose_clothed(
        &self,
        displacement: &Array3<f32>,
        wearers: &[BodySpec],
    ) -> Result<Vec<Mesh>> {
        let expected = (wearers.len(), self.body().vertices(), 3);
        if displacement.dim() != expected {
            return Err(Error::argument(format!(
                "displacements {:?}, expected {expected:?}",
                displacement.dim()
            )));
        }
        self.pose_meshes(Some(displacement), wearers)
    }

    /// Bodies without clothes.
    ///
    /// # Errors
    /// If a body has too many shape coefficients, or numbers are not finite.
    pub fn pose_unclothed(&self, wearers: &[BodySpec]) -> Result<Vec<Mesh>> {
        self.pose_meshes(None, wearers)
    }

    /// Posterior means `[n, latent]` of clothes: displacements `[n, vertices, 3]` in metres, seen
    /// under the poses and outfits of `wearers`.
    ///
    /// # Errors
    /// If sizes disagree, or numbers are not finite.
    pub fn encode(&self, displacement: &Array3<f32>, wearers: &[BodySpec]) -> Result<Array2<f32>> {
        let (n, vertices) = (wearers.len(), self.body().vertices());
        if displacement.dim() != (n, vertices, 3) {
            return Err(Error::argument(format!(
                "displacements {:?}, expected {:?}",
                displacement.dim(),
                (n, vertices, 3)
            )));
        }
        if displacement.iter().any(|x| !x.is_finite()) {
            return Err(Error::argument("displacements that are not finite"));
        }
        let (poses, outfits) = poses_and_outfits(wearers);
        let (latent, device) = (self.config().model.latent, self.device());
        let mut means = Vec::with_capacity(n * latent);
        for start in (0..n).step_by(BATCH) {
            let rows = start..(start + BATCH).min(n);
            let count = rows.len();
            let mut values: Vec<f32> =
                displacement.slice(ndarray::s![rows.clone(), .., ..]).iter().copied().collect();
            self.statistics().normalise(&mut values);
            let features = from_array2(pose_features(&poses[rows.clone()])?, device);
            let labels: Vec<[f32; 4]> = outfits[rows].iter().map(|o| o.one_hot()).collect();
            let labels = TensorData::new(labels.as_flattened().to_vec(), [count, 4]);
            means.extend(self.posterior_means(DeviceBatch {
                displacement: Tensor::from_data(
                    TensorData::new(values, [count, vertices, 3]),
                    device,
                ),
                pose_feature: features,
                outfit: Tensor::from_data(labels, device),
            }));
        }
        Array2::from_shape_vec((n, latent), means)
            .map_err(|error| Error::argument(error.to_string()))
    }

    /// Posterior means `[n, latent]` of `frames` of a packed set.
    ///
    /// # Errors
    /// If the set does not suit the run, or a frame is not there.
    pub fn encode_frames(&self, set: &PackedSet, frames: &[usize]) -> Result<Array2<f32>> {
        self.statistics().expect_vertices(set.vertices())?;
        if let Some(frame) = frames.iter().find(|&&frame| frame >= set.frames()) {
            return Err(Error::argument(format!(
                "frame {frame}: the set has {}, counted from 0",
                set.frames()
            )));
        }
        let latent = self.config().model.latent;
        let mut means = Vec::with_capacity(frames.len() * latent);
        for chunk in frames.chunks(BATCH) {
            let batch = set.batch(chunk, Some(self.statistics()))?;
            means.extend(self.posterior_means(to_device(batch, self.device())));
        }
        Array2::from_shape_vec((frames.len(), latent), means)
            .map_err(|error| Error::argument(error.to_string()))
    }

    fn posterior_means(&self, frames: DeviceBatch) -> Vec<f32> {
        let generator = self.generator();
        let condition = generator.condition.forward(frames.pose_feature, frames.outfit);
        let graph = &self.graphs().generator;
        to_host(generator.encoder.forward(frames.displacement, condition.as_ref(), graph).mean)
    }

    fn pose_meshes(
        &self,
        displacement: Option<&Array3<f32>>,
        wearers: &[BodySpec],
    ) -> Result<Vec<Mesh>> {
        let (most, vertices, device) = (self.body().betas(), self.body().vertices(), self.device());
        let mut meshes = Vec::with_capacity(wearers.len());
        for (index, chunk) in wearers.chunks(BATCH).enumerate() {
            let n = chunk.len();
            let mut betas = Vec::with_capacity(n * most);
            for wearer in chunk {
                let given = &wearer.betas;
                if given.len() > most || given.iter().any(|beta| !beta.is_finite()) {
                    return Err(Error::argument(format!(
                        "betas: {} numbers, expected at most {most}, all finite",
                        given.len()
                    )));
                }
                betas.extend(given.iter().copied().chain(std::iter::repeat(0.0)).take(most));
            }
            let poses: Vec<f32> = chunk.iter().flat_map(|wearer| wearer.pose).collect();
            let worn = displacement.map(|all| {
                let first = index * BATCH;
                let values: Vec<f32> =
                    all.slice(ndarray::s![first..first + n, .., ..]).iter().copied().collect();
                Tensor::<3>::from_data(TensorData::new(values, [n, vertices, 3]), device)
            });
            let rows = |values: Vec<f32>, width: usize| {
                Tensor::<2>::from_data(TensorData::new(values, [n, width]), device)
            };
            let output = self.clothed().forward(SmplInput {
                betas: rows(betas, most),
                pose: Pose::AxisAngle(rows(poses, 72)),
                transl: rows(vec![0.0; 3 * n], 3),
                displacement: worn,
            })?;
            let values = to_host(output.vertices);
            if values.iter().any(|x| !x.is_finite()) {
                return Err(Error::argument("posed vertices are not finite"));
            }
            meshes.extend(values.as_chunks::<3>().0.chunks_exact(vertices).map(|vertices| Mesh {
                vertices: vertices.to_vec(),
                faces: self.body().faces.clone(),
            }));
        }
        Ok(meshes)
    }
}

/// Displacements of a frame of a packed set in metres, `[1, vertices, 3]`, and who wears them: a body of mean
/// shape, since packed sets keep none.
///
/// # Errors
/// If there is no such frame, or it cannot be read.
pub fn registration(set: &PackedSet, frame: usize) -> Result<(Array3<f32>, BodySpec)> {
    let count = set.frames();
    let outfit = *set.outfits().get(frame).filter(|_| frame < count).ok_or_else(|| {
        Error::argument(format!("frame {frame}: the set has {count}, counted from 0"))
    })?;
    let pose = BodyPose::try_from(set.pose(frame)?).map_err(|pose| {
        Error::argument(format!("frame {frame}: a pose of {} numbers", pose.len()))
    })?;
    let wearer = BodySpec { betas: Vec::new(), pose, outfit };
    Ok((set.batch(&[frame], None)?.displacement, wearer))
}

fn poses_and_outfits(wearers: &[BodySpec]) -> (Vec<BodyPose>, Vec<Outfit>) {
    wearers.iter().map(|wearer| (wearer.pose, wearer.outfit)).unzip()
}

/// `steps` codes from `a` to `b`, both included, `[steps, latent]`: on the great circle between
/// their directions, since typical codes of many dimensions lie near a sphere, with lengths blended.
pub fn interpolate_codes(a: &[f32], b: &[f32], steps: usize) -> Array2<f32> {
    let length = |v: &[f32]| v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    let (la, lb) = (length(a), length(b));
    let dot: f64 = a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    let angle = (dot / (la * lb).max(f64::MIN_POSITIVE)).clamp(-1.0, 1.0).acos();
    let straight = la.min(lb) < 1e-6 || angle.sin() < 1e-4;
    let mut codes = Array2::zeros((steps, a.len()));
    for (step, mut row) in codes.rows_mut().into_iter().enumerate() {
        let t = step as f64 / steps.saturating_sub(1).max(1) as f64;
        let [of_a, of_b] = if straight {
            [1.0 - t, t]
        } else {
            let size = la + (lb - la) * t;
            let share = |t: f64| size * (t * angle).sin() / angle.sin();
            [share(1.0 - t) / la, share(t) / lb]
        };
        for (row, (a, b)) in row.iter_mut().zip(a.iter().zip(b)) {
            *row = (of_a * f64::from(*a) + of_b * f64::from(*b)) as f32;
        }
    }
    codes
}

/// A closed walk of `steps` codes, `[steps, latent]`, through the rows of `stops` and back to the
/// first, smooth in every number (a periodic Catmull–Rom spline).
pub fn walk_codes(stops: &Array2<f32>, steps: usize) -> Array2<f32> {
    let n = stops.nrows();
    let mut codes = Array2::zeros((steps, stops.ncols()));
    if n == 0 {
        return codes;
    }
    for (step, mut row) in codes.rows_mut().into_iter().enumerate() {
        let at = step as f64 / steps as f64 * n as f64;
        let (segment, t) = (at as usize % n, at.fract());
        let stop = |offset: usize| stops.index_axis(Axis(0), (segment + n - 1 + offset) % n);
        let points = [stop(0), stop(1), stop(2), stop(3)];
        let weights = [
            -0.5 * t + t * t - 0.5 * t.powi(3),
            1.0 - 2.5 * t * t + 1.5 * t.powi(3),
            0.5 * t + 2.0 * t * t - 1.5 * t.powi(3),
            0.5 * (t.powi(3) - t * t),
        ];
        for (point, weight) in points.iter().zip(weights) {
            row.scaled_add(weight as f32, point);
        }
    }
    codes
}

/// Latent directions sorted by how far a step of one standard deviation moves clothing vertices of
/// the mean code, with that distance, millimetres, for each direction.
///
/// # Errors
/// If the model decodes nothing finite.
pub fn directions_by_effect(run: &Run, wearer: &BodySpec) -> Result<(Vec<usize>, Vec<f64>)> {
    let latent = run.config().model.latent;
    let mut codes = Array2::zeros((2 * latent, latent));
    for direction in 0..latent {
        codes[[2 * direction, direction]] = 1.0;
        codes[[2 * direction + 1, direction]] = -1.0;
    }
    let worn = run.decode_displacements(&codes, &vec![wearer.clone(); 2 * latent])?;
    let effects: Vec<f64> = (0..latent)
        .map(|direction| {
            let [up, down] = [0, 1].map(|side| worn.index_axis(Axis(0), 2 * direction + side));
            let moved = run.clothing().iter().map(|&v| {
                let squares = (0..3).map(|axis| f64::from(up[[v, axis]] - down[[v, axis]]).powi(2));
                squares.sum::<f64>().sqrt()
            });
            1000.0 * moved.sum::<f64>() / (2 * run.clothing().len()).max(1) as f64
        })
        .collect();
    if effects.iter().any(|effect| !effect.is_finite()) {
        return Err(Error::argument("the model decodes displacements that are not finite"));
    }
    let mut order: Vec<usize> = (0..latent).collect();
    order.sort_by(|&a, &b| effects[b].total_cmp(&effects[a]));
    Ok((order, effects))
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn interpolation_turns_directions_and_blends_lengths() {
        let codes = interpolate_codes(&[1.0, 0.0], &[0.0, 3.0], 3);
        let half = 2.0 * std::f32::consts::FRAC_1_SQRT_2;
        let expected = array![[1.0, 0.0], [half, half], [0.0, 3.0]];
        assert!((&codes - &expected).iter().all(|x| x.abs() < 1e-5), "{codes}");
        let straight = interpolate_codes(&[0.0, 0.0], &[2.0, 4.0], 3);
        assert_eq!(straight, array![[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]]);
        let opposite = interpolate_codes(&[1.0, 0.0], &[-1.0, 0.0], 5);
        assert!(opposite.iter().all(|x| x.is_finite()));
        assert_eq!(interpolate_codes(&[1.0], &[2.0], 1), array![[1.0]]);
    }

    #[test]
    fn a_walk_passes_its_stops_and_closes_smoothly() {
        let stops = array![[0.0, 1.0], [2.0, -1.0], [1.0, 3.0]];
        let codes = walk_codes(&stops, 300);
        for stop in 0..3 {
            assert!((&codes.row(100 * stop) - &stops.row(stop)).iter().all(|x| x.abs() < 1e-5));
        }
        for step in 0..300 {
            let moved = &codes.row((step + 1) % 300) - &codes.row(step);
            assert!(moved.iter().all(|x| x.abs() < 0.1), "step {step}: {moved}");
        }
    }
}
