//! Pictures and files of meshes.

use std::path::PathBuf;

use cape_core::{Mesh, ply};
use cape_render::{Image, Object, Style, View, portrait};
use ndarray::{Array2, Array3, ArrayView2};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{prelude::*, types::PyBytes};

use crate::error::{argument, core, render};

/// Vertices `[V, 3]` and faces `[F, 3]`.
type MeshArrays<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u32>>);

/// Draw a mesh of vertices `[V, 3]`, faces `[F, 3]` and colours `[V, 3]` (sRGB from 0 to 1), seen from
/// an angle in front: pixels `[height, width, 4]`.
#[pyfunction]
pub(crate) fn draw<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<'py, f32>,
    faces: PyReadonlyArray2<'py, u32>,
    colours: PyReadonlyArray2<'py, f32>,
    size: (u32, u32),
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let mesh = mesh(vertices.as_array(), faces.as_array())?;
    let colours = triples("colours", colours.as_array())?;
    if colours.len() != mesh.vertices.len() {
        let (found, expected) = (colours.len(), mesh.vertices.len());
        return Err(argument(format!("colours: {found} rows, expected {expected}")));
    }
    let style = Style { width: size.0, height: size.1, ..Style::default() };
    let image = py
        .detach(|| portrait(Object::new(&mesh).with_colours(&colours), View::ThreeQuarter, &style))
        .map_err(render)?;
    let shape = (image.height() as usize, image.width() as usize, 4);
    let pixels = Array3::from_shape_vec(shape, image.pixels().as_flattened().to_vec())
        .map_err(|error| argument(error.to_string()))?;
    Ok(pixels.into_pyarray(py))
}

/// Encode pixels `[height, width, 4]` as PNG.
#[pyfunction]
pub(crate) fn encode_png<'py>(
    py: Python<'py>,
    pixels: PyReadonlyArray3<'py, u8>,
) -> PyResult<Bound<'py, PyBytes>> {
    let pixels = pixels.as_array();
    let (height, width, channels) = pixels.dim();
    if channels != 4 {
        return Err(argument(format!("pixels: {channels} channels, expected 4")));
    }
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    let mut image = Image::new(side(width), side(height), [0; 4]).map_err(render)?;
    for (to, &from) in image.pixels_mut().as_flattened_mut().iter_mut().zip(pixels) {
        *to = from;
    }
    let mut file = Vec::new();
    image.encode(&mut file).map_err(|error| argument(error.to_string()))?;
    Ok(PyBytes::new(py, &file))
}

/// Write a mesh of vertices `[V, 3]` and faces `[F, 3]` as `.obj` or `.ply`; the latter with colours
/// `[V, 3]`, 0 to 255, if given.
#[pyfunction]
#[pyo3(signature = (path, vertices, faces, colours=None))]
pub(crate) fn save_mesh(
    py: Python<'_>,
    path: PathBuf,
    vertices: PyReadonlyArray2<'_, f32>,
    faces: PyReadonlyArray2<'_, u32>,
    colours: Option<PyReadonlyArray2<'_, u8>>,
) -> PyResult<()> {
    let mesh = mesh(vertices.as_array(), faces.as_array())?;
    let colours = colours.map(|rows| triples("colours", rows.as_array())).transpose()?;
    let is_ply = path.extension().is_some_and(|found| found.eq_ignore_ascii_case("ply"));
    py.detach(|| match colours {
        Some(colours) if is_ply => ply::write(path, &mesh, Some(&colours)),
        _ => mesh.save(path),
    })
    .map_err(core)
}

/// Read the vertices `[V, 3]` and faces `[F, 3]` of an OBJ, PLY, STL, OFF or `.glb` file.
#[pyfunction]
pub(crate) fn load_mesh(py: Python<'_>, path: PathBuf) -> PyResult<MeshArrays<'_>> {
    let mesh = py.detach(|| Mesh::load(path)).map_err(core)?;
    Ok((rows(mesh.vertices).into_pyarray(py), rows(mesh.faces).into_pyarray(py)))
}

fn rows<T: Copy>(triples: Vec<[T; 3]>) -> Array2<T> {
    Array2::from_shape_fn((triples.len(), 3), |(row, column)| triples[row][column])
}

fn mesh(vertices: ArrayView2<'_, f32>, faces: ArrayView2<'_, u32>) -> PyResult<Mesh> {
    let vertices = triples("vertices", vertices)?;
    if vertices.as_flattened().iter().any(|x| !x.is_finite()) {
        return Err(argument("vertices: not finite".to_owned()));
    }
    let faces = triples("faces", faces)?;
    if let Some(vertex) = faces.as_flattened().iter().find(|&&v| v as usize >= vertices.len()) {
        let count = vertices.len();
        return Err(argument(format!("faces: vertex {vertex}, but there are {count} vertices")));
    }
    Ok(Mesh { vertices, faces })
}

fn triples<T: Copy>(name: &str, rows: ArrayView2<'_, T>) -> PyResult<Vec<[T; 3]>> {
    if rows.ncols() != 3 {
        return Err(argument(format!("{name}: {} columns, expected 3", rows.ncols())));
    }
    Ok(rows.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}
