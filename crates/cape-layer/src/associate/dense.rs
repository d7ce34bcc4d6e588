use std::collections::{BTreeMap, HashMap};

use ndarray::Array2;
use rayon::prelude::*;

use super::{AssociateOptions, RayStatistics, SparseCorrespondences};
use crate::{Error, Result, geometry::Geodesics};
use cape_core::expect_finite;
use cape_core::geometry::SurfaceMesh;

/// Most votes that a vertex passes on to neighbours outside the support.
const PASSED_ON: usize = 64;

/// Number of clothing vertices without votes within the support, by the remedy.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Completion {
    /// Vertices that got votes when the support was widened by one ring of neighbours, by two, ….
    pub widened: Vec<usize>,
    /// Vertices in connected parts of the clothing without any pair, which follow the pair nearest in
    /// space.
    pub isolated: usize,
}

impl Completion {
    /// Total number of these vertices.
    pub fn total(&self) -> usize {
        self.widened.iter().sum::<usize>() + self.isolated
    }
}

/// Body vertices `I_j` that each clothing vertex follows, and their weights `ω` (§3.1).
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_layer::AssociateOptions;
///
/// // Each corner of an octahedron follows the body corner below it.
/// let (body, clothing) = (octahedron(0.1), octahedron(0.12));
/// let association = AssociateOptions::default().associate(&body, &clothing)?;
/// assert_eq!((association.clothing_vertices(), association.neighbours()), (6, 4));
/// assert!((0..6).all(|corner| association.indices[(corner, 0)] == corner as u32));
/// // Every body vertex hit the clothing; the support was not widened.
/// assert_eq!((association.statistics.hits, association.completion.total()), (6, 0));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Association {
    /// Body vertices `I_j`, the most probable first, `[n_v, n_f]`.
    pub indices: Array2<u32>,
    /// Weights `ω`, which sum to 1 in each row, `[n_v, n_f]`. Where fewer than `n_f` body vertices
    /// got votes, the first is repeated with weight 0.
    pub weights: Array2<f64>,
    /// Number of sparse pairs.
    pub pairs: usize,
    /// Counts of ray hits.
    pub statistics: RayStatistics,
    /// Clothing vertices without votes within the support.
    pub completion: Completion,
}

type Votes = Vec<(u32, f64)>;

impl Association {
    /// An association from indices `[n_v, n_f]` below `body_vertices` and weights of the same shape.
    ///
    /// # Errors
    /// If shapes differ, an index is out of range, or a row of weights is not finite or does not
    /// sum to 1.
    pub fn new(indices: Array2<u32>, weights: Array2<f64>, body_vertices: usize) -> Result<Self> {
        if indices.dim() != weights.dim() || indices.ncols() == 0 {
            return Err(Error::argument(format!(
                "association: indices {:?} and weights {:?}, expected one shape [n_v, n_f]",
                indices.shape(),
                weights.shape()
            )));
        }
        if let Some(index) = indices.iter().find(|&&index| index as usize >= body_vertices) {
            return Err(Error::argument(format!(
                "association: body vertex {index}, expected below {body_vertices}"
            )));
        }
        expect_finite("association weights", &weights)?;
        if let Some(row) = weights.rows().into_iter().position(|w| (w.sum() - 1.0).abs() > 1e-6) {
            return Err(Error::argument(format!(
                "association: the weights of clothing vertex {row} do not sum to 1"
            )));
        }
        let (statistics, completion) = (RayStatistics::default(), Completion::default());
        Ok(Self { indices, weights, pairs: 0, statistics, completion })
    }

    /// Number of clothing vertices, `n_v`.
    pub fn clothing_vertices(&self) -> usize {
        self.indices.nrows()
    }

    /// Number of body vertices for each clothing vertex, `n_f`.
    pub fn neighbours(&self) -> usize {
        self.indices.ncols()
    }

    /// Colours of the clothing, `[n_v, 3]`: those of the body, `[V, 3]`, blended by the weights.
    ///
    /// # Errors
    /// If a body vertex has no colour.
    pub fn colours(&self, body: &[[u8; 3]]) -> Result<Vec<[u8; 3]>> {
        let rows = self.indices.rows().into_iter().zip(self.weights.rows());
        rows.map(|(indices, weights)| {
            let mut mixed = [0.0; 3];
            for (&index, weight) in indices.iter().zip(weights) {
                let colour = body.get(index as usize).ok_or_else(|| {
                    Error::argument(format!(
                        "colours: {} for the body, but the clothing follows vertex {index}",
                        body.len()
                    ))
                })?;
                mixed.iter_mut().zip(colour).for_each(|(m, &c)| *m += weight * f64::from(c));
            }
            Ok(mixed.map(|m| m.round() as u8))
        })
        .collect()
    }

    /// Fuzzy correspondences by the votes of `pairs` (eq. 2): with squared geodesic distances `r`,
    /// `P(v_k^C, v_l^B) = Σ_(i,j) exp(−(r(v_k^C, v_i^C) + r(v_l^B, v_j^B)) / σ²)`.
    ///
    /// The support is then widened one ring of neighbours at a time: a clothing vertex without
    /// votes gets the normalised votes of its neighbours, each divided by the length of the edge
    /// between them. A connected part of the clothing without any pair follows the pair nearest in
    /// space.
    pub(super) fn spread(
        body: &SurfaceMesh,
        clothing: &SurfaceMesh,
        pairs: SparseCorrespondences,
        options: &AssociateOptions,
    ) -> Self {
        let SparseCorrespondences { pairs, statistics } = pairs;
        let on_body = Geodesics::new(body, options.metric);
        let on_clothing = Geodesics::new(clothing, options.metric);
        let kernel = |r: f64, sigma: f64| (-(r / sigma).powi(2)).exp();
        // Votes of each pair for body vertices, by its clothing vertex.
        let pair_votes: HashMap<u32, Votes> = pairs
            .par_iter()
            .map(|pair| {
                let near = on_body.within(pair.body, options.support);
                let votes = near.into_iter().map(|(v, r)| (v, kernel(r, options.sigma)));
                (pair.clothing, votes.collect())
            })
            .collect();
        let gather = |vertex: u32| -> Votes {
            let mut sums: HashMap<u32, f64> = HashMap::new();
            for (near, r) in on_clothing.within(vertex, options.support) {
                let share = kernel(r, options.sigma);
                for &(body, vote) in pair_votes.get(&near).into_iter().flatten() {
                    *sums.entry(body).or_default() += share * vote;
                }
            }
            sums.into_iter().collect()
        };
        let mut votes: Vec<Votes> = (0..clothing.vertices.len() as u32)
            .into_par_iter()
            .map(|vertex| most_probable(gather(vertex), PASSED_ON.max(options.neighbours)))
            .collect();
        let mut completion = Completion::default();
        let mut missing = without(&votes);
        let neighbours = adjacency(clothing);
        while !missing.is_empty() {
            let widened: Vec<Votes> = missing
                .par_iter()
                .map(|&vertex| pass_on(&votes, &neighbours[vertex as usize]))
                .collect();
            let before = missing.len();
            for (&vertex, widened) in missing.iter().zip(widened) {
                votes[vertex as usize] = widened;
            }
            missing = without(&votes);
            if missing.len() == before {
                break;
            }
            completion.widened.push(before - missing.len());
        }
        completion.isolated = missing.len();
        for vertex in missing {
            let at = clothing.vertices[vertex as usize];
            let far = |v: u32| clothing.vertices[v as usize].distance_squared(at);
            let nearest = pairs.iter().min_by(|p, q| far(p.clothing).total_cmp(&far(q.clothing)));
            if let Some(pair) = nearest {
                votes[vertex as usize].clone_from(&pair_votes[&pair.clothing]);
            }
        }
        let votes: Vec<Votes> =
            votes.into_iter().map(|votes| most_probable(votes, options.neighbours)).collect();
        let (indices, weights) = normalised(&votes, options.neighbours);
        Self { indices, weights, pairs: pairs.len(), statistics, completion }
    }
}

/// The `count` largest votes, descending, the lower vertex first among equal ones.
fn most_probable(mut votes: Votes, count: usize) -> Votes {
    votes.sort_unstable_by(|p, q| q.1.total_cmp(&p.1).then(p.0.cmp(&q.0)));
    votes.truncate(count);
    votes
}

/// Neighbours of each vertex, with the lengths of the edges to them, metres.
fn adjacency(surface: &SurfaceMesh) -> Vec<Vec<(u32, f64)>> {
    let mut neighbours = vec![Vec::new(); surface.vertices.len()];
    for [a, b] in surface.edges() {
        let length = surface.vertices[a as usize].distance(surface.vertices[b as usize]);
        neighbours[a as usize].push((b, length));
        neighbours[b as usize].push((a, length));
    }
    neighbours
}

/// Votes of the neighbours, normalised and divided by the edge lengths, summed.
fn pass_on(votes: &[Votes], neighbours: &[(u32, f64)]) -> Votes {
    let mut sums: BTreeMap<u32, f64> = BTreeMap::new();
    for &(neighbour, length) in neighbours {
        let own = &votes[neighbour as usize];
        let all: f64 = own.iter().map(|v| v.1).sum();
        for &(body, vote) in own {
            *sums.entry(body).or_default() += vote / (all * length.max(f64::MIN_POSITIVE));
        }
    }
    most_probable(sums.into_iter().collect(), PASSED_ON)
}

/// Vertices without votes.
fn without(votes: &[Votes]) -> Vec<u32> {
    let empty = votes.iter().enumerate().filter(|(_, votes)| votes.is_empty());
    empty.map(|(vertex, _)| vertex as u32).collect()
}

/// Indices and weights of votes; weights sum to 1 in each row.
fn normalised(votes: &[Votes], count: usize) -> (Array2<u32>, Array2<f64>) {
    let mut indices = Array2::zeros((votes.len(), count));
    let mut weights = Array2::zeros((votes.len(), count));
    for (row, votes) in votes.iter().enumerate() {
        let sum: f64 = votes.iter().map(|v| v.1).sum();
        if let Some(&(first, _)) = votes.first() {
            indices.row_mut(row).fill(first);
        }
        for (k, &(vertex, vote)) in votes.iter().enumerate() {
            indices[(row, k)] = vertex;
            weights[(row, k)] = vote / sum;
        }
    }
    (indices, weights)
}
