//! Values of chumpy's arrays and views.

use ndarray::{ArrayD, IxDyn};

use super::value::Value;
use crate::{Result, npy::NpyElement};

impl Value<'_> {
    pub(super) fn chumpy<T: NpyElement>(&self, depth: usize) -> Result<ArrayD<T>> {
        let class = self.class().unwrap_or_default();
        match class.rsplit('.').next().unwrap_or_default() {
            "Ch" => self.require("x")?.array_within(depth),
            "Select" => self.selection(depth),
            "reshape" | "Reshape" => {
                let array = self.require("a")?.array_within(depth)?;
                self.reshaped(array, "newshape", depth)
            }
            "transpose" => {
                let array: ArrayD<T> = self.require("a")?.array_within(depth)?;
                match self.get("axes").filter(|axes| !axes.is_none()) {
                    None => Ok(array.reversed_axes().as_standard_layout().into_owned()),
                    Some(axes) => {
                        let axes = self.permutation(&axes, array.ndim())?;
                        Ok(array.permuted_axes(axes).as_standard_layout().into_owned())
                    }
                }
            }
            _ => Err(self.error(format!(
                "is a `{class}`, an expression that this reader does not evaluate; save its value \
                 instead (`numpy.array(x.r)`)"
            ))),
        }
    }

    /// `a.ravel()[idxs]` in the shape `preferred_shape`.
    fn selection<T: NpyElement>(&self, depth: usize) -> Result<ArrayD<T>> {
        let array: ArrayD<T> = self.require("a")?.array_within(depth)?;
        let indices = self.require("idxs")?;
        if indices.is_mask() {
            return Err(indices.error("is a boolean mask, expected indices"));
        }
        let indices: ArrayD<i64> = indices.array_within(depth)?;
        self.charge(indices.len() * size_of::<T>())?;
        let values: Vec<T> = array.iter().copied().collect();
        let selected = indices.iter().map(|&index| {
            // Python counts negative indices from the end.
            let from_start = if index < 0 { index + values.len() as i64 } else { index };
            usize::try_from(from_start).ok().and_then(|at| values.get(at).copied()).ok_or_else(
                || {
                    self.error(format!(
                        "index {index} is out of range for {} elements",
                        values.len()
                    ))
                },
            )
        });
        let selected =
            ArrayD::from_shape_vec(IxDyn(indices.shape()), selected.collect::<Result<_>>()?)
                .map_err(|source| self.error(source.to_string()))?;
        self.reshaped(selected, "preferred_shape", depth)
    }

    /// `array` reshaped to attribute `name`, if present. One axis may be −1.
    fn reshaped<T: NpyElement>(
        &self,
        array: ArrayD<T>,
        name: &str,
        depth: usize,
    ) -> Result<ArrayD<T>> {
        let Some(shape) = self.get(name).filter(|shape| !shape.is_none()) else {
            return Ok(array);
        };
        let axes: ArrayD<i64> = shape.array_within(depth)?;
        let known: i64 = axes
            .iter()
            .filter(|&&axis| axis >= 0)
            .try_fold(1i64, |n, &axis| n.checked_mul(axis))
            .unwrap_or(0);
        let open = axes.iter().filter(|&&axis| axis < 0).count();
        let axes: Vec<usize> = axes
            .iter()
            .map(|&axis| match usize::try_from(axis) {
                Ok(axis) => axis,
                Err(_) if open == 1 && known > 0 => array.len() / known as usize,
                Err(_) => usize::MAX,
            })
            .collect();
        let length = array.len();
        array
            .into_shape_with_order(IxDyn(&axes))
            .map_err(|_| self.error(format!("cannot reshape {length} numbers to {axes:?}")))
    }
}
