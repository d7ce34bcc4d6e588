//! Source of the arrays of a body: `.npz` archive or pickle.

use std::{fs::File, io::Read, path::Path};

use ndarray::{Array2, ArrayD};

use crate::{
    Error, Result,
    npy::{NpyElement, Npz, expect_shape},
    pickle::Pickle,
    unexpected_content,
};

/// An open body file.
pub(super) enum Source {
    Npz(Npz),
    Pickle(Pickle),
}

impl Source {
    /// Opens a file, whose first bytes select the format.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let mut start = Vec::new();
        let file = File::open(path).map_err(|source| Error::io(path, source))?;
        if file.metadata().is_ok_and(|metadata| metadata.is_dir()) {
            return Err(Error::format(path, "is a directory, expected a body file"));
        }
        let length = file.metadata().map_err(|source| Error::io(path, source))?.len();
        file.take(4096).read_to_end(&mut start).map_err(|source| Error::io(path, source))?;
        if let Some(found) = unexpected_content(&start, length) {
            return Err(Error::format(path, found));
        }
        if Pickle::is_start(&start) {
            return Ok(Self::Pickle(Pickle::open(path)?));
        }
        Ok(Self::Npz(Npz::open(path)?))
    }

    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Npz(npz) => npz.path(),
            Self::Pickle(pickle) => pickle.path(),
        }
    }

    pub(super) fn contains(&self, name: &str) -> bool {
        match self {
            Self::Npz(npz) => npz.contains(name),
            Self::Pickle(pickle) => pickle.root().get(name).is_some(),
        }
    }

    pub(super) fn array<T: NpyElement>(&mut self, name: &str) -> Result<ArrayD<T>> {
        match self {
            Self::Npz(npz) => {
                if !npz.is_object(name)? {
                    return npz.get(name);
                }
                let objects = npz.objects(name)?;
                objects.root().array().map_err(|error| within(npz.path(), name, error))
            }
            Self::Pickle(pickle) => pickle.root().require(name)?.array(),
        }
    }

    /// A matrix of shape `expected`, dense or sparse.
    pub(super) fn matrix(&mut self, name: &str, expected: [usize; 2]) -> Result<Array2<f64>> {
        match self {
            Self::Npz(npz) => {
                if npz.is_object(name)? {
                    let objects = npz.objects(name)?;
                    let matrix = objects.root().matrix(expected);
                    return matrix.map_err(|error| within(npz.path(), name, error));
                }
                let array = npz.f64(name)?;
                expect_shape(npz.path(), name, array.shape(), &expected.map(Some))?;
                array
                    .into_dimensionality()
                    .map_err(|failed| Error::field(npz.path(), name, failed.to_string()))
            }
            Self::Pickle(pickle) => pickle.root().require(name)?.matrix(expected),
        }
    }
}

/// Adds the name of the archive's array to an error about a pickle in it.
fn within(path: &Path, name: &str, error: Error) -> Error {
    match error {
        Error::Format { message, .. } => Error::field(path, name, message),
        Error::Field { field, message, .. } => {
            Error::field(path, format!("{name}.{field}"), message)
        }
        other => other,
    }
}
