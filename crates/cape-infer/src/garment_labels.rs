//! Skin, shirt and trousers of a clothed body, told apart by the steps of its displacements at hems.

use cape_core::SmplModel;
use ndarray::{ArrayView1, ArrayView2};
use serde::Serialize;

/// Length of displacement at which skin begins to change to cloth, and from which on it is cloth, metres.
const CLOTH: [f32; 2] = [0.0025, 0.0038];
/// Difference of the displacements of two neighbours from which on a hem is likely between them, metres.
const STEP: f32 = 0.004;
/// Least coupling of neighbours, relative to that without a step.
const COUPLING: f32 = 1e-3;
/// Weight of a displacement as short as that of skin, relative to that of a longer one: cloth can lie on
/// the skin, and where all around is cloth, it does.
const SKIN_WEIGHT: f32 = 0.03;
/// Sweeps over the vertices that find shirt and trousers, and that find cloth.
const SWEEPS: [usize; 2] = [300, 40];

const PELVIS: usize = 0;
const SPINE: usize = 3;
const HIPS: [usize; 2] = [1, 2];
const KNEES: [usize; 2] = [4, 5];
/// Joints of the legs, which tell trousers from shirt.
const LEGS: [usize; 8] = [1, 2, 4, 5, 7, 8, 10, 11];
/// Pelvis, spine and collars: covered in every outfit.
const TRUNK: [usize; 6] = [PELVIS, SPINE, 6, 9, 13, 14];

/// Tables and numbers by which vertices are told apart: skin, shirt and trousers.
///
/// ```
/// use cape_core::ClothingMask;
/// use cape_infer::GarmentColours;
///
/// let body = cape_synth::synthetic_body();
/// let mask = ClothingMask::from_weights(&body)?;
/// let tables = GarmentColours::new(&body, &mask).tables();
/// assert_eq!(tables.covered, mask.covered());
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GarmentTables {
    /// True at vertices of the clothing mask, `[V]`.
    #[serde(skip)]
    pub covered: Vec<bool>,
    /// True at vertices of the trunk, which every outfit covers, `[V]`.
    #[serde(skip)]
    pub trunk: Vec<bool>,
    /// True where the share of trousers is known beforehand, `[V]`.
    #[serde(skip)]
    pub known: Vec<bool>,
    /// Share of trousers where it is known, and its first guess elsewhere, 0 to 1, `[V]`.
    #[serde(skip)]
    pub trousers: Vec<f32>,
    /// Length of displacement at which skin begins to change to cloth, and from which on it is cloth,
    /// metres.
    pub cloth: [f32; 2],
    /// Difference of the displacements of two neighbours from which on a hem is likely between them,
    /// metres.
    pub step: f32,
    /// Least coupling of neighbours, relative to that without a step.
    pub coupling: f32,
    /// Weight of a displacement as short as that of skin, relative to that of a longer one.
    pub skin_weight: f32,
    /// Sweeps over the vertices that find shirt and trousers, and that find cloth.
    pub sweeps: [usize; 2],
}

/// Shares of cloth and, of the cloth, of trousers, at a vertex, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GarmentShares {
    pub(crate) cloth: f32,
    pub(crate) trousers: f32,
}

/// Labels of the vertices of a body by garment.
///
/// Shirt and trousers are the two sides of a harmonic function that is 0 above the waist and 1 below the
/// middle of the thighs, and whose neighbours are coupled the less, the more their displacements differ:
/// it jumps at the shirt's hem, where displacements step from one garment to the other (Grady, *Random
/// walks for image segmentation*, 2006). Cloth and skin are told apart likewise, by a function that is 1 on
/// the trunk, 0 at hands, feet and head, and is drawn elsewhere towards 1 where displacements are long and,
/// weakly, towards 0 where they are short.
#[derive(Debug)]
pub(crate) struct GarmentLabels {
    neighbours: Vec<Vec<u32>>,
    covered: Vec<bool>,
    /// Share of trousers where it is known, and the first guess elsewhere.
    known: Vec<Option<f32>>,
    guess: Vec<f32>,
    trunk: Vec<bool>,
}

impl GarmentLabels {
    pub(crate) fn new(body: &SmplModel, covered: &[bool]) -> Self {
        let mut neighbours = vec![Vec::new(); body.vertices()];
        for &[a, b, c] in &body.faces {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                neighbours[from as usize].push(to);
                neighbours[to as usize].push(from);
            }
        }
        for near in &mut neighbours {
            near.sort_unstable();
            near.dedup();
        }
        let share = |row: ArrayView1<f64>, joints: &[usize]| {
            joints.iter().filter_map(|&joint| row.get(joint)).sum::<f64>()
        };
        let at = body.joint_regressor.dot(&body.v_template);
        let height = |joints: &[usize]| {
            joints.iter().map(|&joint| at[(joint, 1)]).sum::<f64>() / joints.len() as f64
        };
        let (waist, hip, knee) = (height(&[SPINE]), height(&HIPS), height(&KNEES));
        let thigh = 0.5 * (hip + knee);
        let rows = body.weights.rows().into_iter().zip(body.v_template.column(1));
        let mut known = Vec::with_capacity(body.vertices());
        let mut guess = Vec::with_capacity(body.vertices());
        for (row, &y) in rows {
            let legs = share(row, &LEGS);
            let trunk = share(row, &TRUNK);
            known.push(if legs > 0.5 && y < thigh {
                Some(1.0)
            } else if y > waist || legs + trunk < 0.5 {
                // Hands hang below the waist only in other rest poses than SMPL's.
                Some(0.0)
            } else {
                None
            });
            guess.push(((hip - y) / (waist - thigh) + 0.5).clamp(0.0, 1.0) as f32);
        }
        let trunk = body.weights.rows().into_iter().map(|row| share(row, &TRUNK) > 0.65).collect();
        Self { neighbours, covered: covered.to_vec(), known, guess, trunk }
    }

    /// Tables and numbers of the method.
    pub(crate) fn tables(&self) -> GarmentTables {
        GarmentTables {
            covered: self.covered.clone(),
            trunk: self.trunk.clone(),
            known: self.known.iter().map(Option::is_some).collect(),
            trousers: self.first_trousers(),
            cloth: CLOTH,
            step: STEP,
            coupling: COUPLING,
            skin_weight: SKIN_WEIGHT,
            sweeps: SWEEPS,
        }
    }

    /// Shares of trousers, known or guessed.
    fn first_trousers(&self) -> Vec<f32> {
        self.known.iter().zip(&self.guess).map(|(known, guess)| known.unwrap_or(*guess)).collect()
    }

    /// Shares by vertex for displacements `[V, 3]`, metres.
    pub(crate) fn shares(&self, displacement: ArrayView2<f32>) -> Vec<GarmentShares> {
        let count = self.neighbours.len();
        let couplings: Vec<Vec<f32>> = (0..count)
            .map(|v| {
                let own = displacement.row(v);
                let coupling = |&n: &u32| {
                    let other = displacement.row(n as usize);
                    let squared: f32 =
                        own.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
                    let steps = squared / (STEP * STEP);
                    COUPLING + 1.0 / (1.0 + steps * steps)
                };
                self.neighbours[v].iter().map(coupling).collect()
            })
            .collect();
        let mean = |v: usize, of: &[f32]| {
            let near = self.neighbours[v].iter().zip(&couplings[v]);
            let (sum, weight) = near.fold((0.0, 0.0), |(sum, weight), (&n, &coupling)| {
                (sum + coupling * of[n as usize], weight + coupling)
            });
            sum / f32::max(weight, f32::MIN_POSITIVE)
        };

        let mut trousers = self.first_trousers();
        let unknown: Vec<usize> = (0..count).filter(|&v| self.known[v].is_none()).collect();
        for _ in 0..SWEEPS[0] {
            for &v in &unknown {
                trousers[v] = mean(v, &trousers);
            }
        }

        let mut cloth: Vec<f32> = (0..count)
            .map(|v| {
                let row = displacement.row(v);
                let length = row.dot(&row).sqrt();
                match (self.covered[v], self.trunk[v]) {
                    (false, _) => 0.0,
                    (true, true) => 1.0,
                    (true, false) => ramp(length, CLOTH[0], CLOTH[1]),
                }
            })
            .collect();
        let free: Vec<(usize, f32)> = (0..count)
            .filter(|&v| self.covered[v] && !self.trunk[v])
            .map(|v| (v, cloth[v]))
            .collect();
        for _ in 0..SWEEPS[1] {
            for &(v, likely) in &free {
                let weight = SKIN_WEIGHT + (1.0 - SKIN_WEIGHT) * likely;
                cloth[v] = (weight * likely + mean(v, &cloth)) / (weight + 1.0);
            }
        }
        let sharp = |share: f32| ramp(share, 0.4, 0.6);
        let shares = cloth.into_iter().zip(trousers);
        shares.map(|(c, t)| GarmentShares { cloth: sharp(c), trousers: sharp(t) }).collect()
    }
}

/// From 0 at `low` to 1 at `high`.
fn ramp(value: f32, low: f32, high: f32) -> f32 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use cape_core::smpl::ClothingMask;
    use cape_synth::synthetic_body;
    use ndarray::Array2;

    use super::*;

    /// A shirt 15 mm from the skin down to a height, and trousers 4 mm from it.
    #[test]
    fn the_shirt_ends_where_displacements_step() {
        let body = synthetic_body();
        let mask = ClothingMask::from_weights(&body).unwrap();
        let labels = GarmentLabels::new(&body, mask.covered());
        let joints = body.joint_regressor.dot(&body.v_template);
        let [hip, spine] = [1, 3].map(|joint| joints[(joint, 1)]);
        for hem in [hip + 0.04, hip - 0.04, 0.5 * (hip + spine)] {
            let worn = Array2::from_shape_fn((body.vertices(), 3), |(v, axis)| {
                let far: f32 = if body.v_template[(v, 1)] > hem { 0.015 } else { 0.004 };
                if axis == 2 { far } else { 0.0 }
            });
            let shares = labels.shares(worn.view());
            let mut wrong = 0;
            let mut near = 0;
            for (v, share) in shares.iter().enumerate() {
                let y = body.v_template[(v, 1)];
                let legs_or_trunk: f64 =
                    LEGS.iter().chain(&TRUNK).map(|&joint| body.weights[(v, joint)]).sum();
                if mask.covered()[v] && (y - hem).abs() < 0.1 && legs_or_trunk > 0.9 {
                    near += 1;
                    wrong += usize::from((share.trousers > 0.5) == (y > hem));
                }
            }
            assert!(near > 200 && wrong * 50 < near, "{wrong} of {near} at {hem}");
        }
    }

    /// Trousers that touch the front of a thigh, where displacements fall to zero, and end at the knees.
    #[test]
    fn cloth_that_touches_the_skin_is_cloth() {
        let body = synthetic_body();
        let mask = ClothingMask::from_weights(&body).unwrap();
        let labels = GarmentLabels::new(&body, mask.covered());
        let joints = body.joint_regressor.dot(&body.v_template);
        let knee = joints[(4, 1)];
        let middle = (&joints.row(1) + &joints.row(4)) / 2.0;
        let touches = |v: usize| {
            let at = body.v_template.row(v);
            let (x, y) = (at[0] - middle[0], at[1] - middle[1]);
            if at[2] > middle[2] { (x * x + y * y).sqrt() } else { f64::INFINITY }
        };
        let worn = Array2::from_shape_fn((body.vertices(), 3), |(v, axis)| {
            let far =
                if body.v_template[(v, 1)] > knee { (touches(v) / 10.0).min(0.012) } else { 0.0 };
            if axis == 2 { far as f32 } else { 0.0 }
        });
        let shares = labels.shares(worn.view());
        let mut touching = 0;
        for (v, share) in shares.iter().enumerate() {
            let y = body.v_template[(v, 1)];
            let leg = [1, 2, 4, 5].iter().map(|&j| body.weights[(v, j)]).sum::<f64>() > 0.9;
            if leg && mask.covered()[v] && (y - knee).abs() > 0.03 {
                assert_eq!(share.cloth > 0.5, y > knee, "{y} {share:?}");
                let length = worn.row(v).dot(&worn.row(v)).sqrt();
                touching += usize::from(y > knee && length < CLOTH[0]);
            }
        }
        assert!(touching > 3, "{touching}");
    }

    #[test]
    fn sleeves_end_where_displacements_do() {
        let body = synthetic_body();
        let mask = ClothingMask::from_weights(&body).unwrap();
        let labels = GarmentLabels::new(&body, mask.covered());
        let elbow = body.joint_regressor.dot(&body.v_template)[(18, 0)];
        let worn = Array2::from_shape_fn((body.vertices(), 3), |(v, axis)| {
            let sleeve = body.v_template[(v, 0)].abs() < elbow;
            if axis == 1 && sleeve { 0.012 } else { 0.0 }
        });
        let shares = labels.shares(worn.view());
        for (v, share) in shares.iter().enumerate() {
            let x = body.v_template[(v, 0)].abs();
            let arm = [16, 17, 18, 19].iter().map(|&j| body.weights[(v, j)]).sum::<f64>() > 0.9;
            if arm && mask.covered()[v] && (x - elbow).abs() > 0.02 {
                assert_eq!(share.cloth > 0.5, x < elbow, "{x} {share:?}");
            }
            if !mask.covered()[v] {
                assert_eq!(share.cloth, 0.0);
            }
        }
    }
}
