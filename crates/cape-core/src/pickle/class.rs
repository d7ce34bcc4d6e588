//! The names that are let through.

/// A class or function that a pickle names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Class {
    pub(super) kind: Kind,
    /// Module and name, with a dot between.
    pub(super) name: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// `numpy.core.multiarray._reconstruct`, `copy_reg._reconstructor`: an empty instance of the
    /// class that is their first argument.
    Empty,
    /// `numpy.ndarray` and its subclasses.
    NdArray,
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
    /// Anything of chumpy's.
    Chumpy,
    /// Data whose class nothing here depends on.
    Record,
}

impl Class {
    /// The class `name` of `module`, if it is one of those that may be read.
    pub(super) fn find(module: &str, name: &str) -> Option<Self> {
        let kind = kind(module, name)?;
        Some(Self { kind, name: format!("{module}.{name}") })
    }
}

fn kind(module: &str, name: &str) -> Option<Kind> {
    let top = module.split('.').next()?;
    Some(match (top, name) {
        ("copy_reg" | "copyreg", "_reconstructor") if module == top => Kind::Empty,
        ("__builtin__" | "builtins", _) if module == top => match name {
            "object" => Kind::Record,
            "set" | "frozenset" | "list" | "tuple" => Kind::Sequence,
            "dict" => Kind::Dict,
            "bytes" | "bytearray" => Kind::Bytes,
            _ => return None,
        },
        ("collections", "OrderedDict") if module == top => Kind::Dict,
        ("_codecs", "encode") if module == top => Kind::Encode,
        ("numpy", _) => numpy(module, name)?,
        ("scipy", _) if module.starts_with("scipy.sparse") => match name {
            "csc_matrix" | "csc_array" => Kind::Csc,
            "csr_matrix" | "csr_array" => Kind::Csr,
            "coo_matrix" | "coo_array" => Kind::Coo,
            _ => return None,
        },
        ("chumpy", _) => Kind::Chumpy,
        ("sklearn", "GMM" | "DPGMM" | "VBGMM" | "GaussianMixture" | "BayesianGaussianMixture")
            if module.starts_with("sklearn.mixture") =>
        {
            Kind::Record
        }
        _ => return None,
    })
}

fn numpy(module: &str, name: &str) -> Option<Kind> {
    Some(match (module, name) {
        ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => Kind::Empty,
        ("numpy.core.multiarray" | "numpy._core.multiarray", "scalar") => Kind::Scalar,
        ("numpy.core.numeric" | "numpy._core.numeric", "_frombuffer") => Kind::FromBuffer,
        ("numpy", "dtype") => Kind::DType,
        ("numpy", "ndarray" | "matrix" | "memmap")
        | ("numpy.matrixlib.defmatrix", "matrix")
        | ("numpy.core.memmap" | "numpy._core.memmap", "memmap") => Kind::NdArray,
        // The state of a random generator that an estimator was made with.
        _ if module.starts_with("numpy.random") => match name {
            "RandomState"
            | "Generator"
            | "MT19937"
            | "PCG64"
            | "__RandomState_ctor"
            | "__randomstate_ctor"
            | "__generator_ctor"
            | "__bit_generator_ctor" => Kind::Record,
            _ => return None,
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_data_get_through() {
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
            ("chumpyx", "Ch"),
            ("sklearn.mixture", "joblib"),
            ("", ""),
        ] {
            assert_eq!(Class::find(module, name), None, "{module}.{name}");
        }
        for (module, name, kind) in [
            ("numpy.core.multiarray", "_reconstruct", Kind::Empty),
            ("numpy", "ndarray", Kind::NdArray),
            ("scipy.sparse.csc", "csc_matrix", Kind::Csc),
            ("scipy.sparse._coo", "coo_array", Kind::Coo),
            ("chumpy.reordering", "Select", Kind::Chumpy),
            ("sklearn.mixture._gaussian_mixture", "GaussianMixture", Kind::Record),
        ] {
            assert_eq!(Class::find(module, name).unwrap().kind, kind, "{module}.{name}");
        }
    }
}
