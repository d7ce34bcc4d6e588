//! The benchmark: what it reports, and how it refuses.

use crate::support::{run, run_line};

#[test]
fn a_benchmark_reports_positive_numbers() {
    let report = run_line("eval speed --json --batch 1 --preset tiny --threads 1").json();
    let number = |key: &str| {
        let value = report[key].as_f64();
        value.unwrap_or_else(|| panic!("`{key}` is not a number: {report}"))
    };
    for key in [
        "seconds_per_update",
        "examples_per_second",
        "gflops",
        "peak_fraction",
        "peak_gflops",
        "gflop_per_update",
        "decode_ms_batch1",
        "decode_ms_batch16",
        "encode_ms_batch16",
    ] {
        assert!(number(key) > 0.0 && number(key).is_finite(), "{report}");
    }
    assert!(number("peak_fraction") < 1.5, "{report}");
    assert!(number("updates") >= 3.0, "{report}");
    assert_eq!([number("batch"), number("threads")], [1.0, 1.0]);
    assert_eq!(report["preset"], "tiny");
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    assert!(report["device"].is_string(), "{report}");
    if cfg!(target_os = "linux") {
        assert!(number("peak_rss_mb") > 1.0, "{report}");
    } else {
        assert!(report["peak_rss_mb"].is_null(), "{report}");
    }
}

#[test]
fn impossible_benchmarks_are_refused() {
    for (option, value) in [("--threads", "0"), ("--batch", "0"), ("--batch", "1000000")] {
        let ran = run(["eval", "speed", option, value]);
        assert_eq!(ran.code, Some(2), "{}", ran.err);
        assert_eq!(ran.out, "");
        let said = format!("invalid value '{value}' for '{option} <N>': must be ");
        assert!(ran.err.contains(&said), "{}", ran.err);
    }
    run_line("eval speed --device tpu").failed_saying(&["unknown device `tpu`"]);
    run_line("eval speed --count").failed_saying(&["--count", "runs no kernels", "--device wgpu"]);
}
