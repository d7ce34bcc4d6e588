use burn::tensor::{Device, Tensor};

use crate::{Error, Result};

/// Device names accepted by [`parse_device`] in this build.
pub const DEVICES: &[&str] = &[
    #[cfg(feature = "flex")]
    "flex",
    #[cfg(feature = "ndarray")]
    "ndarray",
    #[cfg(feature = "wgpu")]
    "wgpu",
    #[cfg(feature = "cuda")]
    "cuda",
];

/// All CPU devices of this build.
pub fn devices() -> Vec<Device> {
    vec![
        #[cfg(feature = "flex")]
        Device::flex(),
        #[cfg(feature = "ndarray")]
        ndarray(),
    ]
}

/// True for a CPU device of this build.
pub fn is_cpu(device: &Device) -> bool {
    devices().contains(device)
}

/// Burn's deprecated CPU backend, supported as long as Burn ships it.
#[cfg(feature = "ndarray")]
#[expect(deprecated)]
fn ndarray() -> Device {
    Device::ndarray()
}

/// Opens the device `flex`, `ndarray`, `wgpu[:index]` or `cuda[:index]`; `wgpu:cpu` is a software
/// adapter. A small computation on it checks that it works.
///
/// # Errors
/// If the name is unknown, its backend is not compiled in, or the check fails.
pub fn parse_device(name: &str) -> Result<Device> {
    let (backend, index) = match name.split_once(':') {
        Some((backend, index)) => (backend, Some(index)),
        None => (name, None),
    };
    let device = match (backend, index) {
        #[cfg(feature = "flex")]
        ("flex", None) => Device::flex(),
        #[cfg(feature = "ndarray")]
        ("ndarray", None) => ndarray(),
        #[cfg(feature = "wgpu")]
        ("wgpu", index) => {
            use burn::tensor::DeviceKind;
            Device::wgpu(match index {
                None => DeviceKind::DefaultDevice,
                Some("cpu") => DeviceKind::Cpu,
                Some(index) => DeviceKind::DiscreteGpu(number(name, index)?),
            })
        }
        #[cfg(feature = "cuda")]
        ("cuda", index) => Device::cuda(index.map_or(Ok(0), |index| number(name, index))?),
        ("flex" | "ndarray", Some(_)) => {
            return Err(Error::Argument(format!("device `{name}`: {backend} takes no index")));
        }
        #[allow(unreachable_patterns)] // reachable where that backend is left out
        ("flex" | "ndarray" | "wgpu" | "cuda", _) => {
            return Err(Error::Argument(format!(
                "device `{name}` is not compiled in: rebuild with `--features {backend}`, or use \
                 one of: {}",
                DEVICES.join(", ")
            )));
        }
        _ => {
            return Err(Error::Argument(format!(
                "unknown device `{name}`: expected flex, ndarray, wgpu[:index] or cuda[:index]"
            )));
        }
    };
    probe_device(name, device)
}

#[cfg(any(feature = "wgpu", feature = "cuda"))]
fn number(name: &str, index: &str) -> Result<usize> {
    index
        .parse()
        .map_err(|_| Error::Argument(format!("device `{name}`: `{index}` is not a device index")))
}

/// Runs a small computation on `device`; a panic of Burn becomes an error.
fn probe_device(name: &str, device: Device) -> Result<Device> {
    let probe = device.clone();
    let works = catch_panic(move || {
        let sum = Tensor::<1>::ones([2], &probe).sum().into_scalar::<f32>();
        sum == 2.0
    });
    match works {
        Ok(true) => Ok(device),
        Ok(false) => Err(Error::Argument(format!("device `{name}` computes wrong results"))),
        Err(reason) => Err(Error::Argument(format!("device `{name}` cannot be used: {reason}"))),
    }
}

/// Runs `f` on a new thread and returns the message of a panic as the error.
fn catch_panic<T: Send + 'static>(f: impl FnOnce() -> T + Send + 'static) -> Result<T, String> {
    std::thread::spawn(f).join().map_err(|panic| {
        panic
            .downcast_ref::<String>()
            .cloned()
            .or_else(|| panic.downcast_ref::<&str>().map(|&message| message.to_owned()))
            .unwrap_or_else(|| "unknown reason".into())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn compiled_devices_parse() {
        for &name in DEVICES.iter().filter(|name| ["flex", "ndarray"].contains(name)) {
            parse_device(name).unwrap();
        }
    }

    #[test]
    fn errors_say_what_to_do() {
        let message = |name| parse_device(name).unwrap_err().to_string();
        assert!(message("tpu").contains("unknown device `tpu`"));
        assert!(message("flex:1").contains("takes no index"));
        #[cfg(not(feature = "cuda"))]
        assert!(message("cuda:0").contains("--features cuda"));
    }
}
