//! Allow list of classes and functions.

/// Class or function that a pickle refers to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Class {
    pub(super) kind: ClassKind,
    /// Qualified name, `module.name`.
    pub(super) name: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ClassKind {
    /// `numpy.core.multiarray._reconstruct`, `copy_reg._reconstructor`: an empty instance of the
    /// class that is their first argument.
    Empty,
    /// `numpy.ndarray` and its subclasses.
    NdArray,
    /// joblib's description of an array whose data follow in the file.
    JoblibArray,
    /// `numpy.core.numeric._frombuffer`.
    FromBuffer,
    /// `numpy.dtype`.
    DType,
    /// `numpy.core.multiarray.scalar`.
    Scalar,
    /// `_codecs.encode`.
    Encode,
    /// `bytes` and `bytearray`.
    Bytes,
    /// `set`, `frozenset`, `list`, `tuple`.
    Sequence,
    /// `dict`, `OrderedDict`.
    Dict,
    Csc,
    Csr,
    Coo,
    /// Any class of chumpy.
    Chumpy,
    /// Data whose class does not matter.
    Record,
}

impl ClassKind {
    /// True for a NumPy array, however it is stored.
    pub(super) const fn is_array(self) -> bool {
        matches!(self, Self::NdArray | Self::FromBuffer | Self::JoblibArray)
    }
}

impl Class {
    /// The class `name` of `module`, if it is on the allow list.
    pub(super) fn find(module: &str, name: &str) -> Option<Self> {
        let kind = kind(module, name)?;
        Some(Self { kind, name: format!("{module}.{name}") })
    }
}

fn kind(module: &str, name: &str) -> Option<ClassKind> {
    let top = module.split('.').next()?;
    Some(match (top, name) {
        ("copy_reg" | "copyreg", "_reconstructor") if module == top => ClassKind::Empty,
        ("__builtin__" | "builtins", _) if module == top => match name {
            "set" | "frozenset" | "list" | "tuple" => ClassKind::Sequence,
            "dict" => ClassKind::Dict,
            "bytes" | "bytearray" => ClassKind::Bytes,
            // Default factories of `defaultdict`.
            "object" | "int" | "float" | "str" | "bool" => ClassKind::Record,
            _ => return None,
        },
        ("collections", "OrderedDict" | "defaultdict") if module == top => ClassKind::Dict,
        ("joblib", "NumpyArrayWrapper") if module == "joblib.numpy_pickle" => {
            ClassKind::JoblibArray
        }
        ("pathlib", "PosixPath" | "WindowsPath" | "PurePosixPath" | "PureWindowsPath") => {
            ClassKind::Record
        }
        ("_codecs", "encode") if module == top => ClassKind::Encode,
        ("numpy", _) => numpy(module, name)?,
        ("scipy", _) if module.starts_with("scipy.sparse") => match name {
            "csc_matrix" | "csc_array" => ClassKind::Csc,
            "csr_matrix" | "csr_array" => ClassKind::Csr,
            "coo_matrix" | "coo_array" => ClassKind::Coo,
            _ => return None,
        },
        ("chumpy", _) => ClassKind::Chumpy,
        ("sklearn", "GMM" | "DPGMM" | "VBGMM" | "GaussianMixture" | "BayesianGaussianMixture")
            if module.starts_with("sklearn.mixture") =>
        {
            ClassKind::Record
        }
        _ => return None,
    })
}

fn numpy(module: &str, name: &str) -> Option<ClassKind> {
    Some(match (module, name) {
        ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => ClassKind::Empty,
        ("numpy.core.multiarray" | "numpy._core.multiarray", "scalar") => ClassKind::Scalar,
        ("numpy.core.numeric" | "numpy._core.numeric", "_frombuffer") => ClassKind::FromBuffer,
        ("numpy", "dtype") => ClassKind::DType,
        ("numpy", "ndarray" | "matrix" | "memmap")
        | ("numpy.matrixlib.defmatrix", "matrix")
        | ("numpy.core.memmap" | "numpy._core.memmap", "memmap") => ClassKind::NdArray,
        // State of the random generator of a scikit-learn estimator.
        _ if module.starts_with("numpy.random") => match name {
            "RandomState"
            | "Generator"
            | "MT19937"
            | "PCG64"
            | "__RandomState_ctor"
            | "__randomstate_ctor"
            | "__generator_ctor"
            | "__bit_generator_ctor" => ClassKind::Record,
            _ => return None,
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_data_classes_are_allowed() {
        for (module, name) in [
            ("os", "system"),
            ("posix", "system"),
            ("__builtin__", "eval"),
            ("builtins", "getattr"),
            ("builtins.x", "dict"),
            ("numpy", "load"),
            ("numpy.core.multiarray", "fromfile"),
            ("numpy.testing._private.utils", "runstring"),
            ("numpy.random", "__import__"),
            ("scipy.sparse", "load_npz"),
            ("scipy.io", "csc_matrix"),
            ("joblib.numpy_pickle", "load"),
            ("joblib", "NumpyArrayWrapper"),
            ("chumpyx", "Ch"),
            ("sklearn.mixture", "joblib"),
            ("", ""),
        ] {
            assert_eq!(Class::find(module, name), None, "{module}.{name}");
        }
        for (module, name, kind) in [
            ("numpy.core.multiarray", "_reconstruct", ClassKind::Empty),
            ("numpy", "ndarray", ClassKind::NdArray),
            ("scipy.sparse.csc", "csc_matrix", ClassKind::Csc),
            ("scipy.sparse._coo", "coo_array", ClassKind::Coo),
            ("chumpy.reordering", "Select", ClassKind::Chumpy),
            ("sklearn.mixture._gaussian_mixture", "GaussianMixture", ClassKind::Record),
        ] {
            assert_eq!(Class::find(module, name).unwrap().kind, kind, "{module}.{name}");
        }
    }
}
