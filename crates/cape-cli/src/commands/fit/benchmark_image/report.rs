use std::path::PathBuf;

use cape_fit::benchmark::{BenchmarkCase, BenchmarkOptions, BenchmarkSummary, MethodScores};
use cape_stats::PairedComparison;
use serde::Serialize;

use crate::{error::Result, table::Table};

/// Result of a benchmark.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) out: PathBuf,
    options: BenchmarkOptions,
    #[serde(flatten)]
    summary: BenchmarkSummary,
    cases: Vec<BenchmarkCase>,
}

impl Report {
    pub(super) fn new(
        out: PathBuf,
        options: BenchmarkOptions,
        cases: Vec<BenchmarkCase>,
    ) -> Result<Self> {
        Ok(Self {
            summary: BenchmarkSummary::from_cases(&cases, options.seed)?,
            out,
            options,
            cases,
        })
    }

    pub(super) fn text(&self) -> String {
        let BenchmarkSummary { bare, clothed, squared, distance_mm, outfits, .. } = &self.summary;
        let mut table = Table::new([
            "",
            "squared, cm²",
            "median",
            "mean, mm",
            "median",
            "IoU",
            "seconds",
            "largest",
        ]);
        for (name, score) in [("SMPLify", bare), ("with CAPE", clothed)] {
            let MethodScores { squared, distance_mm, intersection_over_union, seconds } = score;
            table.row([
                name.to_owned(),
                format!("{:.1}", 1e4 * squared.mean),
                format!("{:.1}", 1e4 * squared.median),
                format!("{:.1}", distance_mm.mean),
                format!("{:.1}", distance_mm.median),
                format!("{:.1} %", 100.0 * intersection_over_union.mean),
                format!("{:.1}", seconds.mean),
                format!("{:.1}", seconds.most),
            ]);
        }
        let mut by_outfit =
            Table::new(["outfit", "images", "SMPLify, cm²", "with CAPE, cm²", "improvement"]);
        for part in outfits {
            let [before, after] = [&part.bare, &part.clothed].map(|score| score.squared.mean);
            by_outfit.row([
                part.outfit.to_string(),
                part.images.to_string(),
                format!("{:.1}", 1e4 * before),
                format!("{:.1}", 1e4 * after),
                format!("{:.0} %", 100.0 * (1.0 - after / before)),
            ]);
        }
        let mut lines = vec![
            table.text(),
            String::new(),
            by_outfit.text(),
            String::new(),
            format!(
                "{} images of {}; squared error {}",
                self.summary.images,
                match self.summary.captures {
                    Some(captures) => format!("{captures} captures"),
                    None => "unknown captures".to_owned(),
                },
                comparison(squared)
            ),
            format!(
                "mean error {:+.1} mm ({:+.1} to {:+.1})",
                distance_mm.difference, distance_mm.interval[0], distance_mm.interval[1]
            ),
            format!("{} fits are judged unreliable", self.summary.failed),
        ];
        if let Some(trusted) = self.summary.squared_of_trusted.filter(|_| self.summary.failed > 0) {
            lines.push(format!("reliable fits: squared error {}", comparison(&trusted)));
        }
        lines.push(self.out.join("fits.png").display().to_string());
        lines.join("\n")
    }
}

fn comparison(paired: &PairedComparison) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    format!(
        "{} lower ({} to {}), better in {} of {}, p {}",
        percent(paired.improvement),
        percent(paired.improvement_interval[0]),
        percent(paired.improvement_interval[1]),
        paired.wins,
        paired.images,
        probability(paired.wilcoxon)
    )
}

fn probability(p: f64) -> String {
    if p < 0.001 { format!("= {p:.0e}") } else { format!("= {p:.3}") }
}
