/// Peak resident memory of this process, 10⁶ bytes; `None` without Linux's `/proc`.
pub fn peak_rss_mb() -> Option<f64> {
    parse(&std::fs::read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// Current resident memory of this process, 10⁶ bytes; `None` without Linux's `/proc`.
pub fn rss_mb() -> Option<f64> {
    parse(&std::fs::read_to_string("/proc/self/status").ok()?, "VmRSS:")
}

/// Reads a line such as `VmHWM:  1234 kB`, whose unit is 1024 bytes.
fn parse(status: &str, field: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kibibytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024.0 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_high_water_mark_is_found() {
        let status = "VmSize:\t 9 kB\nVmHWM:\t    2000000 kB\nVmRSS:\t 1 kB\n";
        assert_eq!(parse(status, "VmHWM:"), Some(2048.0));
        assert_eq!(parse(status, "VmRSS:"), Some(0.001024));
        assert_eq!(parse("VmRSS:\t 1 kB\n", "VmHWM:"), None);
        #[cfg(target_os = "linux")]
        assert!(rss_mb() > Some(0.5) && peak_rss_mb() > Some(0.5));
    }
}
