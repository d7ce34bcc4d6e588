//! SciPy sparse matrices.

use ndarray::{Array2, ArrayD};

use super::{class::ClassKind, value::Value};
use crate::{Result, npy::NpyElement};

/// Sparse matrix as coordinate triplets; duplicate entries are summed.
///
/// ```
/// use cape_core::npy::read_objects;
///
/// // An array of two sparse matrices.
/// let pickle = read_objects("fixtures/pickles/object_array.npy")?;
/// let (shape, matrices) = pickle.root().objects()?;
/// assert_eq!(shape, [2]);
/// assert!(matrices[0].is_sparse());
/// let entries = matrices[0].sparse()?;
/// assert_eq!(entries.shape, [3, 5]);
/// let sum: f64 = entries.values.iter().sum();
/// assert!((sum - matrices[0].matrix([3, 5])?.sum()).abs() < 1e-12);
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Triplets {
    /// Numbers of rows and columns.
    pub shape: [usize; 2],
    /// Row of each entry.
    pub rows: Vec<usize>,
    /// Column of each entry.
    pub columns: Vec<usize>,
    /// Value of each entry.
    pub values: Vec<f64>,
}

impl Triplets {
    /// Converts compressed rows (SciPy's `indptr`, `indices`, `data`); the error is the name of the
    /// invalid array and the reason.
    pub(crate) fn from_compressed(
        shape: [usize; 2],
        starts: &[i64],
        indices: &[i64],
        values: Vec<f64>,
    ) -> Result<Self, (&'static str, String)> {
        let covers = starts.first() == Some(&0) && starts.last() == Some(&(values.len() as i64));
        if starts.len().checked_sub(1) != Some(shape[0]) || !covers || !starts.is_sorted() {
            let message = format!(
                "expected {} row starts that rise from 0 to {}",
                shape[0].saturating_add(1),
                values.len()
            );
            return Err(("indptr", message));
        }
        let mut rows = Vec::with_capacity(values.len());
        for (row, range) in starts.windows(2).enumerate() {
            rows.extend(std::iter::repeat_n(row, (range[1] - range[0]) as usize));
        }
        let columns = in_range("indices", indices, values.len(), shape[1])?;
        Ok(Self { shape, rows, columns, values })
    }

    fn transposed(self) -> Self {
        let Self { shape: [rows, columns], rows: r, columns: c, values } = self;
        Self { shape: [columns, rows], rows: c, columns: r, values }
    }

    /// Dense matrix; the caller has checked that the shape is of reasonable size.
    pub(crate) fn dense(&self) -> Array2<f64> {
        let mut dense = Array2::zeros(self.shape);
        for ((&row, &column), &value) in self.rows.iter().zip(&self.columns).zip(&self.values) {
            dense[[row, column]] += value;
        }
        dense
    }
}

fn in_range(
    name: &'static str,
    indices: &[i64],
    count: usize,
    end: usize,
) -> Result<Vec<usize>, (&'static str, String)> {
    if indices.len() != count {
        return Err((name, format!("{} indices, expected {count}, one per value", indices.len())));
    }
    let checked = indices.iter().enumerate().map(|(at, &index)| {
        usize::try_from(index).ok().filter(|&index| index < end).ok_or_else(|| {
            (name, format!("index {index} at position {at}, expected less than {end}"))
        })
    });
    checked.collect()
}

impl Value<'_> {
    /// True for a SciPy sparse matrix (CSC, CSR or COO) or a 0-dimensional array that holds one.
    pub fn is_sparse(&self) -> bool {
        let kind = self.unwrap_scalar().ok().and_then(|value| Some(value.object()?.0.kind));
        matches!(kind, Some(ClassKind::Csc | ClassKind::Csr | ClassKind::Coo))
    }

    /// Entries of a sparse matrix.
    pub fn sparse(&self) -> Result<Triplets> {
        let matrix = self.unwrap_scalar()?;
        let kind = match matrix.object() {
            Some((class, _))
                if matches!(class.kind, ClassKind::Csc | ClassKind::Csr | ClassKind::Coo) =>
            {
                class.kind
            }
            _ => {
                let found = matrix.describe();
                return Err(self.error(format!("is {found}, expected a sparse matrix")));
            }
        };
        let shape = match matrix.get("_shape").or_else(|| matrix.get("shape")) {
            Some(shape) => self.shape(&shape)?,
            None => return Err(matrix.error("is a sparse matrix without a `shape`")),
        };
        let &[rows, columns] = &shape[..] else {
            return Err(matrix.error(format!("has shape {shape:?}, expected two axes")));
        };
        let values = matrix.flat::<f64>("data")?;
        let fault = |(name, message): (&str, String)| match matrix.require(name) {
            Ok(part) => part.error(message),
            Err(missing) => missing,
        };
        if kind == ClassKind::Coo {
            let (r, c) = match matrix.get("coords") {
                Some(coordinates) => match coordinates.elements().as_deref() {
                    Some([r, c]) => {
                        (r.array()?.into_iter().collect(), c.array()?.into_iter().collect())
                    }
                    _ => return Err(coordinates.error("expected rows and columns")),
                },
                None => (matrix.flat("row")?, matrix.flat("col")?),
            };
            let r = in_range("row", &r, values.len(), rows).map_err(fault)?;
            let c = in_range("col", &c, values.len(), columns).map_err(fault)?;
            return Ok(Triplets { shape: [rows, columns], rows: r, columns: c, values });
        }
        let (starts, indices) = (matrix.flat::<i64>("indptr")?, matrix.flat::<i64>("indices")?);
        if kind == ClassKind::Csr {
            Triplets::from_compressed([rows, columns], &starts, &indices, values).map_err(fault)
        } else {
            Triplets::from_compressed([columns, rows], &starts, &indices, values)
                .map(Triplets::transposed)
                .map_err(fault)
        }
    }

    /// Dense values of a dense or sparse matrix of shape `expected`.
    pub fn matrix(&self, expected: [usize; 2]) -> Result<Array2<f64>> {
        let wrong =
            |found: &[usize]| Err(self.error(format!("shape {found:?}, expected {expected:?}")));
        if self.is_sparse() {
            let matrix = self.sparse()?;
            return if matrix.shape == expected {
                Ok(matrix.dense())
            } else {
                wrong(&matrix.shape)
            };
        }
        let array: ArrayD<f64> = self.array()?;
        if array.shape() != expected {
            return wrong(array.shape());
        }
        array.into_dimensionality().map_err(|source| self.error(source.to_string()))
    }

    /// Elements of array `name`, flattened.
    fn flat<T: NpyElement>(&self, name: &str) -> Result<Vec<T>> {
        let array: ArrayD<T> = self.require(name)?.array()?;
        Ok(array.into_iter().collect())
    }
}
