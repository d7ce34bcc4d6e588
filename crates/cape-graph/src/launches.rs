//! Counts of kernel launches on graphics cards.

use serde::Serialize;

/// Numbers of kernel launches of a piece of work.
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use cape_graph::KernelLaunches;
///
/// let device = Device::default();
/// let (sum, launches) = KernelLaunches::during(|| Tensor::<1>::ones([3], &device).sum());
/// assert_eq!(sum.into_scalar::<f32>(), 3.0);
/// // A processor runs no kernels.
/// # if cape_core::is_cpu(&device) {
/// assert_eq!(launches.total(), 0);
/// # }
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct KernelLaunches {
    /// Names of kernels and their numbers of launches, the most frequent first.
    pub kernels: Vec<(String, usize)>,
}

impl KernelLaunches {
    /// Launches of all devices of the process while `work` runs. There are none without a feature of a
    /// graphics card (`wgpu`, `vulkan`, `cuda`), nor on processors.
    pub fn during<R>(work: impl FnOnce() -> R) -> (R, Self) {
        #[cfg(any(feature = "wgpu", feature = "cuda"))]
        return observed::during(work);
        #[cfg(not(any(feature = "wgpu", feature = "cuda")))]
        (work(), Self::default())
    }

    /// Number of launches of all kernels.
    pub fn total(&self) -> usize {
        self.kernels.iter().map(|(_, launches)| launches).sum()
    }
}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
mod observed {
    use std::{
        cmp::Reverse,
        collections::{BTreeMap, HashMap},
        sync::{Arc, Mutex, PoisonError},
    };

    use cubecl::{
        config::{TypeNameFormatLevel, type_name_format},
        logging::{LaunchObservation, LaunchObserver},
    };

    use super::KernelLaunches;

    #[derive(Default)]
    struct LaunchCounter(Mutex<HashMap<&'static str, usize>>);

    impl LaunchObserver for LaunchCounter {
        fn launched(&self, kernel: &'static str) {
            let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            *counts.entry(kernel).or_default() += 1;
        }
    }

    pub(super) fn during<R>(work: impl FnOnce() -> R) -> (R, KernelLaunches) {
        let counter = Arc::new(LaunchCounter::default());
        let observation = LaunchObservation::new(counter.clone());
        let result = work();
        drop(observation);
        let counts = counter.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut named: BTreeMap<String, usize> = BTreeMap::new();
        for (kernel, count) in counts.iter() {
            *named.entry(short_name(kernel)).or_default() += count;
        }
        let mut kernels: Vec<(String, usize)> = named.into_iter().collect();
        kernels.sort_by_key(|&(_, count)| Reverse(count));
        (result, KernelLaunches { kernels })
    }

    /// Name of a kernel and its first type parameter, which tells apart Burn's elementwise operations.
    fn short_name(kernel: &str) -> String {
        let name = type_name_format(kernel, TypeNameFormatLevel::Balanced);
        let parts = name.split(" | ").filter(|part| !part.is_empty() && *part != "TensorArgs");
        parts.take(2).collect::<Vec<_>>().join(" ")
    }
}
