//! Relaxation of the simplified half where its faces fold onto each other.

use std::collections::HashMap;

use glam::DVec3;

/// Cosine of the angle between the normals of two faces below which their edge counts as folded: 110°.
const FOLDED: f64 = -0.34;
/// Most rounds of relaxation.
const ROUNDS: usize = 40;
/// Share of the mean of its neighbours in the new position of a vertex.
const SHARE: f64 = 0.5;

/// Vertices that are moved towards their neighbours, round by round. The same linear map serves all
/// shapes.
#[derive(Default)]
pub(crate) struct Relaxation {
    rounds: Vec<Vec<u32>>,
    around: Vec<Vec<u32>>,
    midline: usize,
}

impl Relaxation {
    /// Finds the rounds after which no edge is folded on any of `forms`: vertices of the half whose
    /// first `midline` lie at x = 0. Edges that resist are left after the last round.
    pub(crate) fn find(faces: &[[u32; 3]], midline: usize, mut forms: Vec<Vec<DVec3>>) -> Self {
        let count = forms.first().map_or(0, Vec::len);
        let mut around = vec![Vec::new(); count];
        let mut edges: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
        for (index, &[a, b, c]) in faces.iter().enumerate() {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                around[from as usize].extend([to]);
                around[to as usize].extend([from]);
                edges.entry([from.min(to), from.max(to)]).or_default().push(index as u32);
            }
        }
        for near in &mut around {
            near.sort_unstable();
            near.dedup();
        }
        let mut relaxation = Self { rounds: Vec::new(), around, midline };
        for _ in 0..ROUNDS {
            let mut round: Vec<u32> = Vec::new();
            for form in &forms {
                for sides in edges.values().filter(|sides| folded(form, faces, sides)) {
                    round.extend(sides.iter().flat_map(|&face| faces[face as usize]));
                }
            }
            if round.is_empty() {
                break;
            }
            round.sort_unstable();
            round.dedup();
            for form in &mut forms {
                relaxation.step(&round, form);
            }
            relaxation.rounds.push(round);
        }
        relaxation
    }

    /// Moves the vertices of a shape of the half.
    pub(crate) fn apply(&self, shape: &mut [DVec3]) {
        for round in &self.rounds {
            self.step(round, shape);
        }
    }

    fn step(&self, round: &[u32], shape: &mut [DVec3]) {
        let moved: Vec<DVec3> = round
            .iter()
            .map(|&v| {
                let near = &self.around[v as usize];
                let sum: DVec3 = near.iter().map(|&n| shape[n as usize]).sum();
                let mut place = shape[v as usize].lerp(sum / near.len() as f64, SHARE);
                if (v as usize) < self.midline {
                    place.x = 0.0;
                }
                place
            })
            .collect();
        round.iter().zip(moved).for_each(|(&v, place)| shape[v as usize] = place);
    }
}

/// True if the two faces at an edge face each other; the second face of an edge of the midline is the
/// mirror image of the first.
fn folded(form: &[DVec3], faces: &[[u32; 3]], sides: &[u32]) -> bool {
    let normal = |face: u32| {
        let [a, b, c] = faces[face as usize].map(|v| form[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    match *sides {
        [one] => {
            let n = normal(one);
            n.dot(DVec3::new(-n.x, n.y, n.z)) < FOLDED
        }
        [one, other] => normal(one).dot(normal(other)) < FOLDED,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat strip of squares, one vertex of which is pulled across its neighbours.
    #[test]
    fn a_fold_is_flattened_and_the_rest_stays() {
        let at = |row: u32, column: u32| row * 9 + column;
        let mut faces = Vec::new();
        for row in 0..8 {
            for column in 0..8 {
                let [a, b] = [at(row, column), at(row, column + 1)];
                let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
                faces.extend([[a, b, c], [b, d, c]]);
            }
        }
        let flat: Vec<DVec3> =
            (0..81).map(|v| DVec3::new(f64::from(v % 9), f64::from(v / 9), 0.0)).collect();
        let mut bent = flat.clone();
        bent[at(4, 4) as usize] = DVec3::new(2.2, 2.4, 0.1);
        let relaxation = Relaxation::find(&faces, 0, vec![flat.clone(), bent.clone()]);
        assert!(!relaxation.rounds.is_empty() && relaxation.rounds.len() < ROUNDS);
        relaxation.apply(&mut bent);
        for face in &faces {
            let [a, b, c] = face.map(|v| bent[v as usize]);
            assert!((b - a).cross(c - a).z > 0.0);
        }
        for v in [at(0, 0), at(8, 8), at(8, 0)] {
            assert_eq!(bent[v as usize], flat[v as usize]);
        }
        assert!(Relaxation::find(&faces, 0, vec![flat]).rounds.is_empty());
    }
}
