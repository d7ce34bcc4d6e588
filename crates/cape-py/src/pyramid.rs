//! Mesh pyramids.

use cape_graph::{Surface, Weighting};
use ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use sprs::CsMat;

use crate::error::{argument, graph};

/// Mesh, its coarser levels, and the matrices between them.
#[pyclass(frozen, module = "cape._cape")]
pub(crate) struct MeshPyramid(cape_graph::MeshPyramid);

/// Compressed rows: `data`, `indices`, `indptr` and the shape.
type Rows<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    (usize, usize),
);

/// Vertices `[V, 3]` and faces `[F, 3]`.
type SurfaceArrays<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>);

#[pymethods]
impl MeshPyramid {
    /// Simplify a mesh once for each factor.
    #[new]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, u32>,
        factors: Vec<f64>,
    ) -> PyResult<Self> {
        let (v, f) = (vertices.as_array(), faces.as_array());
        for (name, width) in [("vertices", v.ncols()), ("faces", f.ncols())] {
            if width != 3 {
                return Err(argument(format!("{name}: {width} columns, expected 3")));
            }
        }
        if v.iter().any(|x| !x.is_finite()) {
            return Err(argument("vertices: not finite".to_owned()));
        }
        let surface = Surface {
            vertices: v.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
            faces: f.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
        };
        py.detach(|| cape_graph::MeshPyramid::build(surface, &factors, Weighting::default()))
            .map(Self)
            .map_err(graph)
    }

    /// Number of levels.
    fn __len__(&self) -> usize {
        self.0.levels().len()
    }

    /// Vertices `[V, 3]` and faces `[F, 3]` of a level.
    fn level<'py>(&self, py: Python<'py>, index: usize) -> PyResult<SurfaceArrays<'py>> {
        let surface = at(self.0.levels(), index, "level")?.surface();
        let vertices =
            Array2::from_shape_fn((surface.vertices.len(), 3), |(i, k)| surface.vertices[i][k]);
        let faces = Array2::from_shape_fn((surface.faces.len(), 3), |(i, k)| surface.faces[i][k]);
        Ok((vertices.into_pyarray(py), faces.into_pyarray(py)))
    }

    /// Rescaled Laplacian of a level, `[V, V]`.
    fn laplacian<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Rows<'py>> {
        Ok(rows(py, &at(self.0.levels(), index, "level")?.rescaled_laplacian()))
    }

    /// Matrix from a level to the next coarser one.
    fn down<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Rows<'py>> {
        Ok(rows(py, &at(self.0.transitions(), index, "transition")?.down_matrix()))
    }

    /// Matrix to a level from the next coarser one.
    fn up<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Rows<'py>> {
        Ok(rows(py, at(self.0.transitions(), index, "transition")?.up()))
    }
}

fn at<'a, T>(items: &'a [T], index: usize, name: &str) -> PyResult<&'a T> {
    items
        .get(index)
        .ok_or_else(|| argument(format!("{name} {index}: expected an index below {}", items.len())))
}

fn rows<'py>(py: Python<'py>, matrix: &CsMat<f64>) -> Rows<'py> {
    let matrix = matrix.to_csr();
    let narrow = |values: &[usize]| values.iter().map(|&i| i as i64).collect::<Vec<_>>();
    let indices = narrow(matrix.indices());
    let starts = narrow(matrix.indptr().to_proper().as_ref());
    let shape = matrix.shape();
    (
        matrix.data().to_vec().into_pyarray(py),
        indices.into_pyarray(py),
        starts.into_pyarray(py),
        shape,
    )
}
