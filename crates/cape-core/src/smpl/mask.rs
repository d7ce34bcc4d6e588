use std::path::Path;

use ndarray::{Array1, Ix1};

use super::SmplModel;
use crate::{
    Error, Result,
    npy::{expect_shape, read_i64, write_npy},
};

/// Joints of uncovered skin: ankles, feet, head, wrists and hands.
const BARE_JOINTS: [usize; 9] = [7, 8, 10, 11, 15, 20, 21, 22, 23];
/// Sum of the blend weights of those joints above which a vertex is uncovered.
const BARE_WEIGHT: f64 = 0.1;

/// Clothing vertices of a body; the displacement of all other vertices is zero.
///
/// ```
/// use cape_core::ClothingMask;
/// use cape_synth::synthetic_body;
///
/// let mask = ClothingMask::from_indices(6, &[5, 1, 2])?;
/// assert_eq!(mask.indices().collect::<Vec<_>>(), [1, 2, 5]);
/// assert_eq!(mask.covered(), [false, true, true, false, false, true]);
/// // Head, hands and feet are uncovered.
/// let derived = ClothingMask::from_weights(&synthetic_body())?;
/// assert!((1..6890).contains(&derived.count()));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClothingMask {
    covered: Vec<bool>,
}

impl ClothingMask {
    /// Mask that covers `indices` of a body of `vertices` vertices.
    pub fn from_indices(vertices: usize, indices: &[usize]) -> Result<Self> {
        let mut covered = vec![false; vertices];
        for &index in indices {
            *covered.get_mut(index).ok_or_else(|| {
                Error::Argument(format!(
                    "clothing vertex {index} is out of range for {vertices} vertices"
                ))
            })? = true;
        }
        Ok(Self { covered })
    }

    /// Reads a list of vertex indices such as `clothing_verts_idx.npy` of the CAPE release.
    pub fn load(path: impl AsRef<Path>, vertices: usize) -> Result<Self> {
        let path = path.as_ref();
        let array = read_i64(path)?;
        expect_shape(path, "clothing vertices", array.shape(), &[None])?;
        let mut covered = vec![false; vertices];
        for &index in &array {
            let slot = usize::try_from(index).ok().and_then(|index| covered.get_mut(index));
            *slot.ok_or_else(|| {
                Error::format(
                    path,
                    format!("vertex {index} is out of range for {vertices} vertices"),
                )
            })? = true;
        }
        Ok(Self { covered })
    }

    /// Writes the indices of the covered vertices as a `.npy` file.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        write_npy::<i64, Ix1>(path, &Array1::from_iter(self.indices().map(|index| index as i64)))
    }

    /// Mask derived from blend weights: all vertices but those of head, hands, feet and toes, an
    /// approximation of the list in the CAPE release.
    ///
    /// # Errors
    /// If the body does not have SMPL's 24 joints.
    pub fn from_weights(model: &SmplModel) -> Result<Self> {
        if model.joints() != crate::joints::JOINTS {
            return Err(Error::Argument(format!(
                "body of {} joints: a clothing mask can be derived for SMPL's 24 only",
                model.joints()
            )));
        }
        let bare = |weights: ndarray::ArrayView1<f64>| {
            BARE_JOINTS.iter().map(|&joint| weights[joint]).sum::<f64>() > BARE_WEIGHT
        };
        Ok(Self { covered: model.weights.rows().into_iter().map(|row| !bare(row)).collect() })
    }

    /// Cover flags of the vertices, `[V]`.
    pub fn covered(&self) -> &[bool] {
        &self.covered
    }

    /// Indices of the covered vertices, ascending.
    pub fn indices(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.covered.len()).filter(|&index| self.covered[index])
    }

    /// Number of covered vertices.
    pub fn count(&self) -> usize {
        self.indices().count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_round_trips_and_is_checked() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("clothing_verts_idx.npy");
        let mask = ClothingMask::from_indices(6, &[5, 1, 2]).unwrap();
        mask.save(&path).unwrap();
        assert_eq!(ClothingMask::load(&path, 6).unwrap(), mask);
        assert_eq!(mask.indices().collect::<Vec<_>>(), [1, 2, 5]);
        assert_eq!(mask.count(), 3);
        let message = ClothingMask::load(&path, 5).unwrap_err().to_string();
        assert!(message.contains("vertex 5 is out of range for 5 vertices"), "{message}");
        assert!(ClothingMask::from_indices(5, &[5]).is_err());
    }

    #[test]
    fn the_derived_mask_leaves_head_hands_and_feet_bare() {
        let mut model = crate::smpl::test_model::random_model();
        assert!(ClothingMask::from_weights(&model).is_err());
        model.weights = ndarray::Array2::zeros((12, 24));
        // Vertex i has weight 1 at joint i; vertex 0 has a small weight at the left wrist too.
        for vertex in 0..12 {
            model.weights[[vertex, vertex]] = 1.0;
        }
        model.weights[[0, 20]] = 0.05;
        model.weights[[1, 20]] = 0.2;
        let mask = ClothingMask::from_weights(&model).unwrap();
        assert_eq!(mask.indices().collect::<Vec<_>>(), [0, 2, 3, 4, 5, 6, 9]);
    }
}
