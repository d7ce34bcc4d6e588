//! Files of pyramids, `.npz`.

use std::path::Path;

use cape_core::npy::{Npz, NpzWriter};
use ndarray::{Array1, Array2, ArrayD, arr0, arr1};
use sprs::CsMat;

use crate::parts::{PyramidParts, sparse_from_triplets};
use crate::pyramid::MeshPyramid;
use crate::topology::Surface;
use crate::upsample::Weighting;
use crate::{Error, Result};

/// Version of the file layout.
const VERSION: i64 = 1;

impl MeshPyramid {
    /// Saves the pyramid as one `.npz`, atomically. For level `i` the file holds `v{i}` `[n, 3]`,
    /// `f{i}` `[m, 3]` (empty if unknown) and `A{i}`, for transition `i` it holds `D{i}` and `U{i}`,
    /// the matrices as triplets (see [`read_sparse`]); and `weighting` (ASCII) and `version`.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        file.add("version", &arr0(VERSION))?;
        file.add("weighting", &arr1(self.weighting.name().as_bytes()))?;
        for (i, level) in self.levels.iter().enumerate() {
            let Surface { vertices, faces } = &level.surface;
            file.add(&format!("v{i}"), &Array2::from(vertices.clone()))?;
            let faces: Vec<[i64; 3]> = faces.iter().map(|face| face.map(i64::from)).collect();
            file.add(&format!("f{i}"), &Array2::from(faces))?;
            write_sparse(&mut file, &format!("A{i}"), &level.adjacency)?;
        }
        for (i, transition) in self.transitions.iter().enumerate() {
            write_sparse(&mut file, &format!("D{i}"), &transition.down_matrix())?;
            write_sparse(&mut file, &format!("U{i}"), &transition.up)?;
        }
        Ok(file.finish()?)
    }

    /// Loads a file of [`MeshPyramid::save`]. Its parts are checked as by
    /// [`MeshPyramid::from_parts`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let file = &mut Npz::open(path)?;
        let field = |file: &Npz, name: &str, message: String| {
            Error::File(cape_core::Error::field(file.path(), name, message))
        };
        let version = file.i64("version")?;
        if version.iter().ne([&VERSION]) {
            let message = format!("version {version}, expected {VERSION}: build the pyramid again");
            return Err(field(file, "version", message));
        }
        let weighting = file.get::<u8>("weighting")?;
        let weighting =
            String::from_utf8_lossy(&weighting.into_iter().collect::<Vec<_>>()).into_owned();
        let Some(weighting) = Weighting::from_name(&weighting) else {
            let message = format!("`{weighting}`, expected `barycentric` or `release`");
            return Err(field(file, "weighting", message));
        };
        let mut parts = PyramidParts { weighting, ..PyramidParts::default() };
        parts.surface.vertices = rows_of_three(file, "v0", Npz::f64)?;
        parts.surface.faces = faces(file, "f0")?;
        parts.adjacency.push(read_sparse(file, "A0")?);
        let mut i = 0;
        while file.contains(&format!("D{i}_shape")) {
            parts.down.push(read_sparse(file, &format!("D{i}"))?);
            parts.up.push(read_sparse(file, &format!("U{i}"))?);
            i += 1;
            parts.adjacency.push(read_sparse(file, &format!("A{i}"))?);
            parts.faces.push(faces(file, &format!("f{i}"))?);
        }
        Self::from_parts(parts)
    }
}

pub(crate) fn make_directory(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path)
        .map_err(|source| Error::Directory { path: path.to_owned(), source })
}

/// Reads a sparse matrix from its triplets in an archive: `<name>_shape` `[2]`, `<name>_row`,
/// `<name>_col` and `<name>_val` `[entries]`.
pub fn read_sparse(file: &mut Npz, name: &str) -> Result<CsMat<f64>> {
    let shape_name = format!("{name}_shape");
    let shape = file.i64(&shape_name)?;
    file.expect_shape(&shape_name, shape.shape(), &[Some(2)])?;
    let axis = |axis: usize| {
        usize::try_from(shape[[axis]]).map_err(|_| {
            Error::File(cape_core::Error::field(
                file.path(),
                &shape_name,
                format!("{shape}, expected two non-negative sizes"),
            ))
        })
    };
    let shape = (axis(0)?, axis(1)?);
    let flat = |array: ArrayD<i64>| array.into_iter().collect::<Vec<_>>();
    let rows = flat(file.i64(&format!("{name}_row"))?);
    let columns = flat(file.i64(&format!("{name}_col"))?);
    let values: Vec<f64> = file.f64(&format!("{name}_val"))?.into_iter().collect();
    sparse_from_triplets(name, shape, &rows, &columns, &values)
}

/// Writes a sparse matrix as triplets, see [`read_sparse`].
pub fn write_sparse(file: &mut NpzWriter, name: &str, matrix: &CsMat<f64>) -> Result<()> {
    let rows: Array1<i64> = matrix.iter().map(|(_, (row, _))| row as i64).collect();
    let columns: Array1<i64> = matrix.iter().map(|(_, (_, column))| column as i64).collect();
    let values: Array1<f64> = matrix.iter().map(|(&value, _)| value).collect();
    file.add(&format!("{name}_shape"), &arr1(&[matrix.rows() as i64, matrix.cols() as i64]))?;
    file.add(&format!("{name}_row"), &rows)?;
    file.add(&format!("{name}_col"), &columns)?;
    file.add(&format!("{name}_val"), &values)?;
    Ok(())
}

fn rows_of_three<T: Copy>(
    file: &mut Npz,
    name: &str,
    read: impl Fn(&mut Npz, &str) -> cape_core::Result<ArrayD<T>>,
) -> Result<Vec<[T; 3]>> {
    let array = read(file, name)?;
    file.expect_shape(name, array.shape(), &[None, Some(3)])?;
    let values: Vec<T> = array.into_iter().collect();
    Ok(values.as_chunks().0.to_vec())
}

fn faces(file: &mut Npz, name: &str) -> Result<Vec<[u32; 3]>> {
    let corners = rows_of_three(file, name, Npz::i64)?;
    let index = |vertex: i64| {
        u32::try_from(vertex).map_err(|_| {
            Error::File(cape_core::Error::field(
                file.path(),
                name,
                format!("vertex index {vertex}, expected 0 to {}", u32::MAX),
            ))
        })
    };
    corners.into_iter().map(|[a, b, c]| Ok([index(a)?, index(b)?, index(c)?])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn octahedron() -> Surface {
        let mut surface = Surface {
            vertices: vec![
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [-1.0, 0.1, 0.0],
                [0.0, -1.0, 0.0],
                [0.0, 0.0, 0.5],
                [0.0, 0.0, -1.0],
            ],
            faces: Vec::new(),
        };
        for (a, b) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
            surface.faces.extend([[a, b, 4], [b, a, 5]]);
        }
        surface
    }

    #[test]
    fn a_saved_pyramid_is_loaded_unchanged() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("pyramid.npz");
        for weighting in [Weighting::Barycentric, Weighting::Release] {
            let pyramid = MeshPyramid::build(octahedron(), &[1.0, 1.3], weighting).unwrap();
            pyramid.save(&path).unwrap();
            assert_eq!(MeshPyramid::load(&path).unwrap(), pyramid);
        }
    }

    #[test]
    fn impossible_triplets_are_named() {
        let refusal = |shape, row: &[i64], value: &[f64]| {
            sparse_from_triplets("A0", shape, row, &vec![0; row.len()], value)
                .unwrap_err()
                .to_string()
        };
        for message in [
            refusal((2, 1), &[0, 2], &[1.0, 1.0]),
            refusal((2, 1), &[0, -1], &[1.0, 1.0]),
            refusal((2, 1), &[0, 0], &[1.0, 1.0]),
            refusal((2, 1), &[0, 1], &[1.0, f64::NAN]),
            refusal((2, 1), &[0, 1], &[1.0]),
            refusal((usize::MAX, 1), &[0, 1], &[1.0, 1.0]),
        ] {
            assert!(message.contains("`A0`"), "{message}");
        }
    }
}
