//! Body files: the official `.npz` layout.

use std::path::Path;

use ndarray::{Array2, Array3, ArrayD, Dimension, Ix2, Ix3};

use super::model::{Fault, SmplModel};
use crate::{
    Error, Result,
    npy::{Npz, NpzWriter},
};

/// The root's parent as the official files store it, −1 in 32 bits.
const NO_PARENT: i64 = u32::MAX as i64;

impl SmplModel {
    /// Reads a body in the official `.npz` layout.
    ///
    /// Arrays: `v_template` `[V, 3]`, `shapedirs` `[V, 3, B]`, `posedirs` `[V, 3, 9·(J − 1)]` or
    /// flattened to `[3·V, 9·(J − 1)]`, `weights` `[V, J]`, `kintree_table` `[2, J]` (parents over
    /// joint numbers; the root's parent is 2³² − 1 or −1), `f` `[faces, 3]`, and `J_regressor`
    /// `[J, V]`, either dense or as SciPy's compressed sparse rows in `J_regressor_data`,
    /// `J_regressor_indices`, `J_regressor_indptr` and, optionally, `J_regressor_shape`. Other
    /// arrays are ignored.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut npz = Npz::open(path)?;
        let v_template: Array2<f64> = array::<Ix2>(&mut npz, "v_template", &[None, Some(3)])?;
        let v = v_template.nrows();
        let weights: Array2<f64> = array::<Ix2>(&mut npz, "weights", &[Some(v), None])?;
        let j = weights.ncols();
        let model = Self {
            shapedirs: array::<Ix3>(&mut npz, "shapedirs", &[Some(v), Some(3), None])?,
            posedirs: pose_directions(&mut npz, v, j)?,
            joint_regressor: joint_regressor(&mut npz, j, v)?,
            parents: parents(&mut npz, j)?,
            faces: faces(&mut npz)?,
            v_template,
            weights,
        };
        match model.check() {
            Ok(()) => Ok(model),
            Err(Fault { field, message }) => Err(Error::field(path, field, message)),
        }
    }

    /// Writes the body in the official `.npz` layout, with a dense regressor, compressed.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
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
        npz.finish()
    }
}

/// Array `name`, its shape checked.
fn array<D: Dimension>(
    npz: &mut Npz,
    name: &str,
    expected: &[Option<usize>],
) -> Result<ndarray::Array<f64, D>> {
    let array = npz.f64(name)?;
    npz.expect_shape(name, array.shape(), expected)?;
    array.into_dimensionality().map_err(|source| Error::field(npz.path(), name, source.to_string()))
}

fn pose_directions(npz: &mut Npz, v: usize, j: usize) -> Result<Array3<f64>> {
    let name = "posedirs";
    let blends = 9 * j.saturating_sub(1);
    let array = npz.f64(name)?;
    if array.shape() != [v * 3, blends] {
        npz.expect_shape(name, array.shape(), &[Some(v), Some(3), Some(blends)])?;
    }
    array
        .into_shape_with_order((v, 3, blends))
        .map_err(|source| Error::field(npz.path(), name, source.to_string()))
}

fn joint_regressor(npz: &mut Npz, j: usize, v: usize) -> Result<Array2<f64>> {
    let name = "J_regressor";
    if npz.contains(name) || !npz.contains("J_regressor_data") {
        return array::<Ix2>(npz, name, &[Some(j), Some(v)]);
    }
    if npz.contains("J_regressor_shape") {
        let shape = npz.i64("J_regressor_shape")?;
        if shape.iter().copied().ne([j as i64, v as i64]) {
            let message = format!("{shape}, expected [{j}, {v}]");
            return Err(Error::field(npz.path(), "J_regressor_shape", message));
        }
    }
    let data = npz.f64("J_regressor_data")?;
    let indices = npz.i64("J_regressor_indices")?;
    let starts = npz.i64("J_regressor_indptr")?;
    npz.expect_shape("J_regressor_data", data.shape(), &[None])?;
    npz.expect_shape("J_regressor_indices", indices.shape(), &[Some(data.len())])?;
    npz.expect_shape("J_regressor_indptr", starts.shape(), &[Some(j + 1)])?;
    let fault = |field: &str, message: String| Err(Error::field(npz.path(), field, message));
    let starts: Vec<usize> = starts.iter().filter_map(|&start| start.try_into().ok()).collect();
    let covers = starts.first() == Some(&0) && starts.last() == Some(&data.len());
    if starts.len() != j + 1 || !covers || !starts.is_sorted() {
        let message = format!("expected row starts that rise from 0 to {}", data.len());
        return fault("J_regressor_indptr", message);
    }
    let mut dense = Array2::zeros((j, v));
    let columns: Vec<i64> = indices.iter().copied().collect();
    let values: Vec<f64> = data.iter().copied().collect();
    for (row, range) in starts.windows(2).enumerate() {
        for at in range[0]..range[1] {
            match usize::try_from(columns[at]) {
                // Repeated entries add up, as in SciPy.
                Ok(column) if column < v => dense[[row, column]] += values[at],
                _ => {
                    let message = format!("{} at {at}, expected less than {v}", columns[at]);
                    return fault("J_regressor_indices", message);
                }
            }
        }
    }
    Ok(dense)
}

fn parents(npz: &mut Npz, j: usize) -> Result<Vec<Option<usize>>> {
    let name = "kintree_table";
    let table: ArrayD<i64> = npz.i64(name)?;
    npz.expect_shape(name, table.shape(), &[Some(2), Some(j)])?;
    let fault = |message: String| Err(Error::field(npz.path(), name, message));
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

fn faces(npz: &mut Npz) -> Result<Vec<[u32; 3]>> {
    let array = npz.get::<u32>("f")?;
    npz.expect_shape("f", array.shape(), &[None, Some(3)])?;
    let corners: Vec<u32> = array.into_iter().collect();
    Ok(corners.as_chunks::<3>().0.to_vec())
}

#[cfg(test)]
mod tests {
    use ndarray::{Array1, array};

    use super::*;
    use crate::smpl::test_model::random_model;

    fn write(path: &Path, model: &SmplModel, change: impl Fn(&mut NpzWriter, &str) -> bool) {
        let mut npz = NpzWriter::create(path).unwrap();
        let tree = array![[u32::MAX, 0, 0, 2], [0, 1, 2, 3]];
        for name in
            ["v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f"]
        {
            if change(&mut npz, name) {
                continue;
            }
            match name {
                "v_template" => npz.add(name, &model.v_template),
                "shapedirs" => npz.add(name, &model.shapedirs),
                "posedirs" => npz.add(name, &model.posedirs),
                "J_regressor" => npz.add(name, &model.joint_regressor),
                "weights" => npz.add(name, &model.weights),
                "kintree_table" => npz.add(name, &tree),
                _ => npz.add(name, &Array2::from(model.faces.clone())),
            }
            .unwrap();
        }
        npz.add("J", &array![1.0]).unwrap();
        npz.finish().unwrap();
    }

    #[test]
    fn a_body_round_trips() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("body.npz");
        let model = random_model();
        model.save(&path).unwrap();
        assert_eq!(SmplModel::load(&path).unwrap(), model);
    }

    #[test]
    fn documented_variants_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("body.npz");
        let model = random_model();
        let (j, v) = model.joint_regressor.dim();
        write(&path, &model, |npz, name| {
            match name {
                "posedirs" => {
                    let flat = model.posedirs.to_shape((3 * v, 27)).unwrap();
                    npz.add(name, &flat).unwrap();
                }
                "J_regressor" => {
                    let dense: Array1<f64> = model.joint_regressor.iter().copied().collect();
                    let columns = Array1::from_iter((0..j * v).map(|at| (at % v) as i64));
                    let starts = Array1::from_iter((0..=j).map(|row| (row * v) as i64));
                    npz.add("J_regressor_data", &dense).unwrap();
                    npz.add("J_regressor_indices", &columns).unwrap();
                    npz.add("J_regressor_indptr", &starts).unwrap();
                    npz.add("J_regressor_shape", &array![j as i64, v as i64]).unwrap();
                }
                _ => return false,
            }
            true
        });
        assert_eq!(SmplModel::load(&path).unwrap(), model);
    }

    #[test]
    fn every_fault_names_its_array() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("body.npz");
        let model = random_model();
        let v = model.vertices();
        let cases: [(&str, Option<ArrayD<f64>>, &str); 11] = [
            ("v_template", None, "missing array"),
            ("v_template", Some(Array2::zeros((v, 4)).into_dyn()), "expected [_, 3]"),
            ("shapedirs", Some(Array3::zeros((v - 1, 3, 2)).into_dyn()), "expected [12, 3, _]"),
            ("posedirs", Some(Array3::zeros((v, 3, 26)).into_dyn()), "expected [12, 3, 27]"),
            ("J_regressor", Some(Array2::zeros((3, v)).into_dyn()), "expected [4, 12]"),
            ("weights", Some(Array2::from_elem((v, 4), f64::NAN).into_dyn()), "not finite"),
            (
                "kintree_table",
                Some(array![[-1., 0., 3., 2.], [0., 1., 2., 3.]].into_dyn()),
                "joint 2 has parent 3",
            ),
            (
                "kintree_table",
                Some(array![[0., 0., 0., 2.], [0., 1., 2., 3.]].into_dyn()),
                "joint 0 has parent 0",
            ),
            (
                "kintree_table",
                Some(array![[-1., 0., 0., 2.], [0., 2., 1., 3.]].into_dyn()),
                "numbered 2",
            ),
            ("f", Some(array![[0., 1., 12.]].into_dyn()), "there are 12 vertices"),
            ("f", Some(array![[0., 1., -1.]].into_dyn()), "does not fit u32"),
        ];
        for (field, replacement, expected) in cases {
            write(&path, &model, |npz, name| {
                if name == field
                    && let Some(array) = &replacement
                {
                    npz.add(name, array).unwrap();
                }
                name == field
            });
            let message = SmplModel::load(&path).unwrap_err().to_string();
            let field = format!("`{field}`");
            assert!(message.contains(expected) && message.contains(&field), "{message}");
        }
    }

    #[test]
    fn compressed_rows_out_of_range_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("body.npz");
        let model = random_model();
        for (column, starts, expected) in
            [(12i64, [0i64, 1, 1, 1, 1], "less than 12"), (0, [0, 2, 1, 1, 1], "row starts")]
        {
            write(&path, &model, |npz, name| {
                if name == "J_regressor" {
                    npz.add("J_regressor_data", &array![1.0]).unwrap();
                    npz.add("J_regressor_indices", &array![column]).unwrap();
                    npz.add("J_regressor_indptr", &Array1::from(starts.to_vec())).unwrap();
                }
                name == "J_regressor"
            });
            let message = SmplModel::load(&path).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
