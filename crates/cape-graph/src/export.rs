//! Export of pyramids as SciPy matrices and OBJ meshes.

use std::io::Write;
use std::path::Path;

use cape_core::npy::NpzWriter;
use cape_core::write_atomically;
use ndarray::{Array1, arr1};
use sprs::CsMat;

use crate::Result;
use crate::pyramid::MeshPyramid;
use crate::store::make_directory;
use crate::topology::Surface;

impl MeshPyramid {
    /// Writes every matrix as `A_i.npz`, `D_i.npz` and `U_i.npz`, readable by
    /// `scipy.sparse.load_npz`, and every level as `level_i.obj` into `directory`, which is created
    /// if it is missing. `D_i` maps level `i` to level `i + 1`, `U_i` level `i + 1` to level `i`.
    pub fn export_scipy(&self, directory: impl AsRef<Path>) -> Result<()> {
        let directory = directory.as_ref();
        make_directory(directory)?;
        for (i, level) in self.levels().iter().enumerate() {
            write_scipy(&directory.join(format!("A_{i}.npz")), level.adjacency())?;
            write_obj(&directory.join(format!("level_{i}.obj")), level.surface())?;
        }
        for (i, transition) in self.transitions().iter().enumerate() {
            write_scipy(&directory.join(format!("D_{i}.npz")), &transition.down_matrix())?;
            write_scipy(&directory.join(format!("U_{i}.npz")), transition.up())?;
        }
        Ok(())
    }
}

fn write_scipy(path: &Path, matrix: &CsMat<f64>) -> Result<()> {
    let integers = |values: &[usize]| values.iter().map(|&x| x as i64).collect::<Array1<i64>>();
    let mut file = NpzWriter::create(path)?;
    file.add("indices", &integers(matrix.indices()))?;
    file.add("indptr", &integers(&matrix.proper_indptr()))?;
    file.add_text("format", "csr")?;
    file.add("shape", &integers(&[matrix.rows(), matrix.cols()]))?;
    file.add("data", &arr1(matrix.data()))?;
    Ok(file.finish()?)
}

/// Writes vertices with full precision, so that levels can be compared exactly.
fn write_obj(path: &Path, surface: &Surface) -> Result<()> {
    write_atomically(path, |file| {
        for [x, y, z] in &surface.vertices {
            writeln!(file, "v {x} {y} {z}")?;
        }
        for [a, b, c] in surface.faces.iter().map(|face| face.map(|vertex| vertex + 1)) {
            writeln!(file, "f {a} {b} {c}")?;
        }
        Ok(())
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use cape_core::npy::Npz;

    use super::*;
    use crate::upsample::Weighting;

    #[test]
    fn matrices_have_the_field_names_of_scipy() {
        let surface = Surface {
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1]],
            faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        };
        let directory = tempfile::tempdir().unwrap();
        let pyramid = MeshPyramid::build(surface, &[1.0], Weighting::Barycentric).unwrap();
        pyramid.export_scipy(directory.path()).unwrap();
        let mut names: Vec<_> = std::fs::read_dir(directory.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        let expected = ["A_0.npz", "A_1.npz", "D_0.npz", "U_0.npz", "level_0.obj", "level_1.obj"];
        assert_eq!(names, expected);

        let mut file = Npz::open(directory.path().join("A_1.npz")).unwrap();
        assert_eq!(file.names(), ["indices", "indptr", "format", "shape", "data"]);
        assert!(file.i64("indptr").unwrap().iter().eq(&[0, 3, 6, 9, 12]));
        let text = std::fs::read_to_string(directory.path().join("level_1.obj")).unwrap();
        assert!(text.contains("v 0 0 0.1\n") && text.ends_with("f 1 4 3\n"), "{text}");
    }
}
