//! Body files in the official `.npz` and pickle layouts.

mod directory;
mod family;
mod source;
#[cfg(test)]
mod tests;

use std::path::Path;

use ndarray::{Array, Array2, Array3, ArrayD, Dimension, Ix2, Ix3};

use self::source::Source;
pub use directory::find_body;

use super::model::{FieldError, SmplModel};
use crate::{
    Error, Result,
    npy::{NpzWriter, expect_shape},
    obj::Uv,
    pickle::Triplets,
};

/// Parent of the root in the official files, −1 as an unsigned 32-bit number.
const NO_PARENT: i64 = u32::MAX as i64;

impl SmplModel {
    /// Reads a body in the official `.npz` or pickle layout.
    ///
    /// Arrays: `v_template` `[V, 3]`, `shapedirs` `[V, 3, B]`, `posedirs` `[V, 3, 9·(J − 1)]` or
    /// flattened to `[3·V, 9·(J − 1)]`, `weights` `[V, J]`, `kintree_table` `[2, J]` (parents over
    /// joint numbers; the root's parent is 2³² − 1 or −1), `f` `[faces, 3]`, and `J_regressor`
    /// `[J, V]`, dense, a SciPy sparse matrix, or its compressed rows in
    /// `J_regressor_data`, `J_regressor_indices`, `J_regressor_indptr` and, optionally,
    /// `J_regressor_shape`. Other arrays are ignored.
    ///
    /// [`Pickle`](crate::pickle::Pickle) reads pickles without Python and evaluates chumpy arrays and
    /// views.
    ///
    /// # Errors
    /// If an array is missing or malformed, the body is of another family (STAR, SMPL-H, SMPL-X, MANO), or a
    /// pickle contains a class that is not allowed.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut source = Source::open(path)?;
        family::refuse_others(&source)?;
        let v_template: Array2<f64> = array::<Ix2>(&mut source, "v_template", &[None, Some(3)])?;
        let v = v_template.nrows();
        let parents = parents(&mut source)?;
        let j = parents.len();
        family::refuse_joints(path, j)?;
        let weights: Array2<f64> = array::<Ix2>(&mut source, "weights", &[Some(v), Some(j)])?;
        let model = Self {
            shapedirs: array::<Ix3>(&mut source, "shapedirs", &[Some(v), Some(3), None])?,
            posedirs: pose_directions(&mut source, v, j)?,
            joint_regressor: joint_regressor(&mut source, j, v)?,
            parents,
            faces: faces(&mut source)?,
            v_template,
            weights,
        };
        match model.check() {
            Ok(()) => Ok(model),
            Err(FieldError { field, message }) => Err(Error::field(path, field, message)),
        }
    }

    /// Writes the body in the official `.npz` layout, compressed, with a dense joint regressor.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        self.archive(path.as_ref())?.finish()
    }

    /// [`save`](Self::save) with texture coordinates `vt` `[points, 2]` and `ft` `[faces, 3]`.
    pub fn save_textured(&self, path: impl AsRef<Path>, uv: &Uv) -> Result<()> {
        let mut npz = self.archive(path.as_ref())?;
        npz.add("vt", &Array2::from(uv.coordinates.clone()))?;
        npz.add("ft", &Array2::from(uv.faces.clone()))?;
        npz.finish()
    }

    /// An open archive with the body's arrays.
    fn archive(&self, path: &Path) -> Result<NpzWriter> {
        self.validate()?;
        let mut npz = NpzWriter::create(path)?.deflate();
        npz.add("v_template", &self.v_template)?;
        npz.add("shapedirs", &self.shapedirs)?;
        npz.add("posedirs", &self.posedirs)?;
        npz.add("J_regressor", &self.joint_regressor)?;
        npz.add("weights", &self.weights)?;
        let tree = Array2::from_shape_fn((2, self.parents.len()), |(row, joint)| match row {
            0 => self.parents[joint].map_or(u32::MAX, |parent| parent as u32),
            _ => joint as u32,
        });
        npz.add("kintree_table", &tree)?;
        npz.add("f", &Array2::from(self.faces.clone()))?;
        Ok(npz)
    }
}

/// Reads array `name` and checks its shape.
fn array<D: Dimension>(
    source: &mut Source,
    name: &str,
    expected: &[Option<usize>],
) -> Result<Array<f64, D>> {
    let array = source.array::<f64>(name)?;
    expect_shape(source.path(), name, array.shape(), expected)?;
    array
        .into_dimensionality()
        .map_err(|failed| Error::field(source.path(), name, failed.to_string()))
}

fn pose_directions(source: &mut Source, v: usize, j: usize) -> Result<Array3<f64>> {
    let name = "posedirs";
    let blends = 9 * j.saturating_sub(1);
    let array = source.array::<f64>(name)?;
    family::refuse_star(source.path(), array.shape().last().copied().unwrap_or(0), j)?;
    if array.shape() != [v * 3, blends] {
        expect_shape(source.path(), name, array.shape(), &[Some(v), Some(3), Some(blends)])?;
    }
    array
        .into_shape_with_order((v, 3, blends))
        .map_err(|failed| Error::field(source.path(), name, failed.to_string()))
}

fn joint_regressor(source: &mut Source, j: usize, v: usize) -> Result<Array2<f64>> {
    let name = "J_regressor";
    if source.contains(name) || !source.contains("J_regressor_data") {
        return source.matrix(name, [j, v]);
    }
    if source.contains("J_regressor_shape") {
        let shape = source.array::<i64>("J_regressor_shape")?;
        if shape.iter().copied().ne([j as i64, v as i64]) {
            let message = format!("is {shape}, expected [{j}, {v}]");
            return Err(Error::field(source.path(), "J_regressor_shape", message));
        }
    }
    let values = source.array::<f64>("J_regressor_data")?;
    let indices: Vec<i64> = source.array("J_regressor_indices")?.into_iter().collect();
    let starts: Vec<i64> = source.array("J_regressor_indptr")?.into_iter().collect();
    Triplets::from_compressed([j, v], &starts, &indices, values.into_iter().collect())
        .map(|entries| entries.dense())
        .map_err(|(part, message)| {
            Error::field(source.path(), format!("J_regressor_{part}"), message)
        })
}

fn parents(source: &mut Source) -> Result<Vec<Option<usize>>> {
    let name = "kintree_table";
    let table: ArrayD<i64> = source.array(name)?;
    expect_shape(source.path(), name, table.shape(), &[Some(2), None])?;
    let j = table.shape()[1];
    let fault = |message: String| Err(Error::field(source.path(), name, message));
    let mut parents = Vec::with_capacity(j);
    for joint in 0..j {
        if table[[1, joint]] != joint as i64 {
            return fault(format!("joint {joint} is numbered {}", table[[1, joint]]));
        }
        parents.push(match table[[0, joint]] {
            -1 | NO_PARENT => None,
            parent => match usize::try_from(parent) {
                Ok(parent) => Some(parent),
                Err(_) => return fault(format!("joint {joint} has parent {parent}")),
            },
        });
    }
    Ok(parents)
}

fn faces(source: &mut Source) -> Result<Vec<[u32; 3]>> {
    let array = source.array::<u32>("f")?;
    expect_shape(source.path(), "f", array.shape(), &[None, Some(3)])?;
    let corners: Vec<u32> = array.into_iter().collect();
    Ok(corners.as_chunks::<3>().0.to_vec())
}
