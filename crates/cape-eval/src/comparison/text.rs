//! Comparison tables as Markdown, CSV and LaTeX.

use std::fmt::Write as _;

use super::{ComparisonRow, ComparisonTable, ConfidenceInterval};

impl ComparisonRow {
    fn cells(&self) -> [String; 9] {
        let interval = match self.interval {
            Some(ConfidenceInterval { low, high }) => format!("{low:.2} to {high:.2}"),
            None => "–".into(),
        };
        let against = match self.against {
            Some((difference, Some(p))) if p < 0.001 => format!("{difference:+.2} (p < 0.001)"),
            Some((difference, Some(p))) => format!("{difference:+.2} (p = {p:.3})"),
            Some((difference, None)) => format!("{difference:+.2}"),
            None => "–".into(),
        };
        let seeds = match self.between_seeds {
            Some(spread) => format!(" (seeds ± {spread:.2})"),
            None => String::new(),
        };
        [
            self.label.clone(),
            format!("{:.2} ± {:.2}{seeds}", self.mean, self.std),
            format!("{:.2}", self.median),
            interval,
            format!("{:.2}", self.posterior_mean),
            against,
            format!("{:.2}", self.detail.edge_mm),
            format!("{:.2}", self.detail.normal_degrees),
            format!("{:.2}", self.detail.high_energy),
        ]
    }
}

impl ComparisonTable {
    /// Header and cells of the table in text.
    pub fn rows(&self) -> ([String; 9], Vec<[String; 9]>) {
        let reference = self.lines.iter().find(|line| self.is_reference(line));
        let against = match reference {
            Some(line) => &format!("against {}", line.label),
            None => "difference",
        };
        let header = [
            "method",
            "error, mm (mean ± std)",
            "median",
            "95 % CI of the mean",
            "posterior mean",
            against,
            "edges, mm",
            "normals, °",
            "fine energy",
        ];
        (header.map(str::to_owned), self.lines.iter().map(ComparisonRow::cells).collect())
    }

    /// True if `line` is the row of the reference method.
    pub fn is_reference(&self, line: &ComparisonRow) -> bool {
        self.reference.as_ref() == Some(&line.name)
    }

    /// Caption of the table.
    pub fn caption(&self) -> String {
        let dependence = match self.captures {
            Some(captures) => format!(
                "Confidence intervals by bootstrap and p-values by sign changes over {captures} \
                 captures, because frames of one capture are not independent."
            ),
            None => "The captures of the frames are unknown, because the packed set has no \
                     test_frames.csv; therefore there are no confidence intervals, p-values and errors \
                     by sequence."
                .to_owned(),
        };
        format!(
            "Euclidean errors at the {} clothing vertices of {} test frames, millimetres, of \
             reconstructions from a sample of the posterior (columns 2 to 4) and from its mean \
             (posterior mean). {dependence} Edges, normals and fine energy (ratio of reconstructed to \
             true displacements in the upper half of the spectrum of the Laplacian; 1 is best) are of \
             the posterior mean. Trained models are of the checkpoint with the lowest validation \
             error.{}",
            self.vertices,
            self.frames,
            self.body.as_ref().map_or_else(String::new, |body| format!(" Body: {body}."))
        )
    }

    /// The table and the errors by outfit and by sequence as Markdown.
    pub fn markdown(&self) -> String {
        let (header, rows) = self.rows();
        let mut text = String::new();
        let mut line = |cells: &[String]| {
            // Writing to a string cannot fail.
            let cells: Vec<String> = cells.iter().map(|cell| markdown(cell)).collect();
            let _ = writeln!(text, "| {} |", cells.join(" | "));
        };
        line(&header);
        line(&vec!["---".to_owned(); header.len()]);
        for row in &rows {
            line(row);
        }
        let _ = writeln!(text, "\n{}", self.caption());
        for (what, of) in [
            (
                "outfit",
                (|line: &ComparisonRow| &line.outfits) as fn(&ComparisonRow) -> &Vec<(String, f64)>,
            ),
            ("sequence", |line: &ComparisonRow| &line.sequences),
        ] {
            let Some(first) = self.lines.first().filter(|line| !of(line).is_empty()) else {
                continue;
            };
            let names: Vec<String> = of(first).iter().map(|(name, _)| markdown(name)).collect();
            let _ = writeln!(text, "\n| error by {what}, mm | {} |", names.join(" | "));
            let _ = writeln!(text, "|---{}|", "|---".repeat(names.len()));
            for line in &self.lines {
                let cells: Vec<String> = of(line).iter().map(|(_, x)| format!("{x:.2}")).collect();
                let _ = writeln!(text, "| {} | {} |", markdown(&line.label), cells.join(" | "));
            }
        }
        text
    }

    /// The table as comma-separated values with full precision.
    pub fn csv(&self) -> String {
        let mut text = "row,seeds,mean,std,median,low,high,posterior_mean,difference,p,edge_mm,\
                        normal_degrees,high_energy,seconds\n"
            .to_owned();
        for line in &self.lines {
            let number = |value: Option<f64>| value.map_or_else(String::new, |x| x.to_string());
            let cells = [
                csv(&line.name),
                line.seeds.to_string(),
                line.mean.to_string(),
                line.std.to_string(),
                line.median.to_string(),
                number(line.interval.map(|interval| interval.low)),
                number(line.interval.map(|interval| interval.high)),
                line.posterior_mean.to_string(),
                number(line.against.map(|(difference, _)| difference)),
                number(line.against.and_then(|(_, p)| p)),
                line.detail.edge_mm.to_string(),
                line.detail.normal_degrees.to_string(),
                line.detail.high_energy.to_string(),
                line.seconds.to_string(),
            ];
            text += &cells.join(",");
            text.push('\n');
        }
        text
    }

    /// The table as LaTeX in the form of the paper's table 2.
    pub fn latex(&self) -> String {
        let mut text = match &self.body {
            Some(body) => format!("% Body: {body}.\n"),
            None => String::new(),
        };
        text += "\\begin{tabular}{lcc}\n\\hline\nmethod & error (mm) & median \\\\\n\\hline\n";
        for line in &self.lines {
            let _ = writeln!(
                text,
                "{} & ${:.2} \\pm {:.2}$ & {:.2} \\\\",
                latex(&line.label),
                line.mean,
                line.std,
                line.median
            );
        }
        text + "\\hline\n\\end{tabular}\n"
    }
}

/// Escapes a cell of a Markdown table.
fn markdown(text: &str) -> String {
    text.replace('|', "\\|")
}

/// Quotes a field of comma-separated values if necessary.
fn csv(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}

/// Escapes special characters of LaTeX.
fn latex(text: &str) -> String {
    let escaped = |c| match c {
        '\\' => r"\textbackslash{}".to_owned(),
        '~' => r"\textasciitilde{}".to_owned(),
        '^' => r"\textasciicircum{}".to_owned(),
        '&' | '%' | '$' | '#' | '_' | '{' | '}' => format!("\\{c}"),
        c => c.to_string(),
    };
    text.chars().map(escaped).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_any_kind_keep_the_table_whole() {
        assert_eq!(markdown("a|b"), r"a\|b");
        assert_eq!(csv("a_b"), "a_b");
        assert_eq!(csv("a, \"b\""), "\"a, \"\"b\"\"\"");
        assert_eq!(latex(r"50%_of\{x}"), r"50\%\_of\textbackslash{}\{x\}");
        assert_eq!(latex("w/o residual block"), "w/o residual block");
    }
}
