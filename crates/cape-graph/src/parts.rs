//! Pyramids from given matrices.

use sprs::{CsMat, TriMat};

use crate::pyramid::{Level, MeshPyramid, Transition};
use crate::topology::Surface;
use crate::upsample::Weighting;
use crate::{Error, Result};

/// Tolerance of the entries of a stored identity and of the sums of barycentric weights.
const ROUNDING: f64 = 1e-6;

/// Matrices of a pyramid that were computed elsewhere.
///
/// A square with an apex, and the square alone:
///
/// ```
/// use cape_graph::{MeshPyramid, PyramidParts, Surface, Weighting, sparse_from_triplets};
///
/// let surface = Surface {
///     vertices: vec![[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [0.5, 0.5, 1.]],
///     faces: vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
/// };
/// // The apex is dropped; it is interpolated half-way between two opposite corners.
/// let (fine, coarse) = (surface.adjacency(), 4);
/// let around = sparse_from_triplets(
///     "A1", (coarse, coarse), &[0, 0, 1, 1, 2, 2, 3, 3], &[1, 3, 0, 2, 1, 3, 2, 0], &[1.0; 8])?;
/// let down = sparse_from_triplets("D0", (coarse, 5), &[0, 1, 2, 3], &[0, 1, 2, 3], &[1.0; 4])?;
/// let up = sparse_from_triplets(
///     "U0", (5, coarse), &[0, 1, 2, 3, 4, 4], &[0, 1, 2, 3, 0, 2], &[1., 1., 1., 1., 0.5, 0.5])?;
/// let pyramid = MeshPyramid::from_parts(PyramidParts {
///     surface,
///     adjacency: vec![fine, around],
///     down: vec![down],
///     up: vec![up],
///     faces: Vec::new(),
///     weighting: Weighting::Barycentric,
/// })?;
/// assert_eq!(pyramid.levels()[1].vertex_count(), 4);
/// assert_eq!(pyramid.transitions()[0].down(), [0, 1, 2, 3]);
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct PyramidParts {
    /// Mesh of level 0; its faces may be empty.
    pub surface: Surface,
    /// Adjacency of every level, `[vertices, vertices]`; only the pattern of non-zeros is used.
    pub adjacency: Vec<CsMat<f64>>,
    /// Selections `D` from each level to the next, `[coarse, fine]`, a single 1 in every row.
    pub down: Vec<CsMat<f64>>,
    /// Interpolations `U` from each level's successor to it, `[fine, coarse]`.
    pub up: Vec<CsMat<f64>>,
    /// Faces of levels 1, 2, …; missing or empty if unknown.
    pub faces: Vec<Vec<[u32; 3]>>,
    /// Method by which `up` was computed.
    pub weighting: Weighting,
}

impl MeshPyramid {
    /// Builds a pyramid from given matrices, after validating them against each other.
    pub fn from_parts(parts: PyramidParts) -> Result<Self> {
        let PyramidParts { surface, adjacency, down, up, mut faces, weighting } = parts;
        let count = adjacency.len();
        for (name, found) in [("D", down.len()), ("U", up.len())] {
            if found + 1 != count {
                return Err(Error::part(
                    name,
                    format!(
                        "{found} matrices for {count} levels of `A`, expected {}",
                        count.max(1) - 1
                    ),
                ));
            }
        }
        if faces.len() >= count {
            let message = format!(
                "{} lists, expected at most {}, one for each level after level 0",
                faces.len(),
                count - 1
            );
            return Err(Error::part("faces", message));
        }
        faces.resize_with(count - 1, Vec::new);

        let mut adjacency = adjacency.into_iter().enumerate();
        let mut levels = Vec::with_capacity(count);
        let mut transitions = Vec::with_capacity(count - 1);
        levels.extend(adjacency.next().map(|(i, a)| level(i, surface, &a)).transpose()?);
        for (((i, a), (d, u)), faces) in adjacency.zip(down.iter().zip(&up)).zip(faces) {
            let vertices = &levels[i - 1].surface.vertices;
            let transition = transition(i - 1, vertices.len(), d, u, weighting)?;
            let vertices = transition.down.iter().map(|&v| vertices[v as usize]).collect();
            levels.push(level(i, Surface { vertices, faces }, &a)?);
            transitions.push(transition);
        }
        Ok(Self { levels, transitions, weighting })
    }
}

/// Matrix `[rows, columns]`, CSR, with the given entries; entries at the same place are summed.
/// Every row must have an entry, as in all matrices of a pyramid. `name` appears in errors.
pub fn sparse_from_triplets(
    name: &str,
    (rows, columns): (usize, usize),
    row: &[i64],
    column: &[i64],
    value: &[f64],
) -> Result<CsMat<f64>> {
    if row.len() != value.len() || column.len() != value.len() {
        let message = format!(
            "{} rows, {} columns and {} values, expected equally many",
            row.len(),
            column.len(),
            value.len()
        );
        return Err(Error::part(name, message));
    }
    if rows > value.len() {
        let message = format!("{} entries leave some of the {rows} rows empty", value.len());
        return Err(Error::part(name, message));
    }
    let mut triplets = TriMat::with_capacity((rows, columns), value.len());
    for ((&r, &c), &value) in row.iter().zip(column).zip(value) {
        let place = usize::try_from(r).ok().zip(usize::try_from(c).ok());
        let Some((r, c)) = place.filter(|&(r, c)| r < rows && c < columns) else {
            let message = format!("entry at ({r}, {c}) of a matrix {rows} × {columns}");
            return Err(Error::part(name, message));
        };
        if !value.is_finite() {
            return Err(Error::part(name, format!("entry at ({r}, {c}) is {value}")));
        }
        triplets.add_triplet(r, c, value);
    }
    let matrix: CsMat<f64> = triplets.to_csr();
    if let Some(empty) = matrix.outer_iterator().position(|row| row.nnz() == 0) {
        return Err(Error::part(name, format!("row {empty} has no entry")));
    }
    Ok(matrix)
}

fn level(index: usize, surface: Surface, adjacency: &CsMat<f64>) -> Result<Level> {
    let name = format!("A{index}");
    expect_shape(&name, adjacency, (surface.vertices.len(), surface.vertices.len()))?;
    let entries: Vec<_> = nonzeros(adjacency).map(|(at, _)| at).collect();
    if let Some((vertex, _)) = entries.iter().find(|(i, j)| i == j) {
        return Err(Error::part(name, format!("vertex {vertex} is its own neighbour")));
    }
    let mut pattern = TriMat::new(adjacency.shape());
    for &(i, j) in &entries {
        pattern.add_triplet(i, j, 1.0);
    }
    let pattern: CsMat<f64> = pattern.to_csr();
    if let Some(&(i, j)) = entries.iter().find(|&&(i, j)| pattern.get(j, i).is_none()) {
        return Err(Error::part(name, format!("({i}, {j}) is an edge, but ({j}, {i}) is not")));
    }
    if let Some(vertex) = pattern.outer_iterator().position(|row| row.nnz() == 0) {
        return Err(Error::part(name, format!("vertex {vertex} has no neighbour")));
    }
    if !surface.faces.is_empty() {
        surface
            .validate_topology()
            .map_err(|error| Error::part(format!("faces {index}"), error.to_string()))?;
        if surface.adjacency() != pattern {
            return Err(Error::part(name, "its edges are not those of the level's faces"));
        }
    }
    Ok(Level { surface, adjacency: pattern })
}

fn transition(
    index: usize,
    fine: usize,
    down: &CsMat<f64>,
    up: &CsMat<f64>,
    weighting: Weighting,
) -> Result<Transition> {
    let coarse = down.rows();
    let name = format!("D{index}");
    expect_shape(&name, down, (coarse, fine))?;
    let mut selected = vec![false; fine];
    let mut selection = Vec::with_capacity(coarse);
    for ((row, column), value) in nonzeros(down) {
        if row != selection.len() || value != 1.0 || std::mem::replace(&mut selected[column], true)
        {
            let message = format!(
                "({row}, {column}) is {value}: every row must have a single 1, each in another \
                 column"
            );
            return Err(Error::part(name, message));
        }
        selection.push(column as u32);
    }
    if selection.len() != coarse {
        return Err(Error::part(name, format!("row {} has no 1", selection.len())));
    }

    let name = format!("U{index}");
    expect_shape(&name, up, (fine, coarse))?;
    let mut weights = TriMat::new((fine, coarse));
    for ((i, j), weight) in nonzeros(up) {
        weights.add_triplet(i, j, weight);
    }
    let up: CsMat<f64> = weights.to_csr();
    for (row, weights) in up.outer_iterator().enumerate() {
        let (count, sum) = (weights.nnz(), weights.data().iter().sum::<f64>());
        if !(1..=3).contains(&count) || !weights.data().iter().all(|w| w.is_finite()) {
            let message = format!("row {row} has {count} weights, expected 1 to 3 of finite value");
            return Err(Error::part(name, message));
        }
        let negative = weights.data().iter().any(|&w| w < -ROUNDING);
        if weighting == Weighting::Barycentric && (negative || (sum - 1.0).abs() > ROUNDING) {
            let message = format!(
                "row {row} has weights {:?}: barycentric ones sum to 1 and are not negative (the \
                 `release` weighting allows others)",
                weights.data()
            );
            return Err(Error::part(name, message));
        }
    }

    let transition = Transition { down: selection, up };
    let identity = Transition::identity(coarse);
    let nearly = |up: &CsMat<f64>| {
        up.iter().all(|(&w, (i, j))| (w - f64::from(u8::from(i == j))).abs() <= ROUNDING)
    };
    let snap = transition.down == identity.down && fine == coarse && nearly(&transition.up);
    Ok(if snap { identity } else { transition })
}

/// Non-zero entries, row by row.
fn nonzeros(matrix: &CsMat<f64>) -> impl Iterator<Item = ((usize, usize), f64)> {
    let csr = matrix.to_csr();
    let entries: Vec<_> = csr.iter().map(|(&value, at)| (at, value)).collect();
    entries.into_iter().filter(|&(_, value)| value != 0.0)
}

fn expect_shape(name: &str, matrix: &CsMat<f64>, expected: (usize, usize)) -> Result<()> {
    if matrix.shape() == expected {
        return Ok(());
    }
    let message = format!("shape {:?}, expected {expected:?}", matrix.shape());
    Err(Error::part(name, message))
}
