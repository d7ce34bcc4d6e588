//! Pyramids for other programs: SciPy matrices and OBJ meshes.

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
    /// Write every matrix as `A_i.npz`, `D_i.npz` and `U_i.npz`, readable by
    /// `scipy.sparse.load_npz`, and every level as `level_i.obj`, into `directory`, which is made
    /// if it is missing. `D_i` leads from level `i` to level `i + 1`, `U_i` back.
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

/// In full precision, so that the level can be compared exactly.
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
