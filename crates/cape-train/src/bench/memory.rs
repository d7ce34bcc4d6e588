/// The most memory this process has had resident, in megabytes of 10⁶ bytes; `None` where the
/// operating system does not say so in Linux's way.
pub(super) fn peak_rss_mb() -> Option<f64> {
    parse(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// Reads the line `VmHWM:  1234 kB`, whose unit is 1024 bytes.
fn parse(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024.0 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_high_water_mark_is_found() {
        let status = "VmSize:\t 9 kB\nVmHWM:\t    2000000 kB\nVmRSS:\t 1 kB\n";
        assert_eq!(parse(status), Some(2048.0));
        assert_eq!(parse("VmRSS:\t 1 kB\n"), None);
        #[cfg(target_os = "linux")]
        assert!(peak_rss_mb().is_some_and(|mb| mb > 0.5));
    }
}
