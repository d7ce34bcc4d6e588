use std::{fmt::Write as _, path::PathBuf};

use cape_study::{
    PlannedPrecision, ScoreOptions, StudyDesign, StudyScore, plan, read_answers, stand_in_answers,
};
use clap::Args;
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    files,
    options::{at_least_one, non_negative, share},
    table::Table,
};

/// Score the answers of raters, or estimate the precision of a number of raters.
///
/// Prints the share of generated pictures that were taken for real, by case and outfit, with a 95 %
/// interval over raters and pairs, the agreement between raters and the paper's shares. With --plan
/// nothing is read but the design.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape study score study --latex table3.tex --csv table3.csv\n  \
                        cape study score study --answers results.json\n  \
                        cape study score study --plan 20\n  cape study score study --stand-in"
)]
pub(crate) struct ScoreArgs {
    /// Directory of a study, as written by `cape study make`.
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// Files of answers, JSON or JSON lines [default: STUDY/answers.jsonl].
    #[arg(long, value_name = "FILE", num_args = 1..)]
    answers: Vec<PathBuf>,
    /// Smallest share of obvious pairs that a rater must answer rightly to count.
    #[arg(long, default_value_t = 0.75, value_name = "SHARE", value_parser = share)]
    catch_share: f64,
    /// Leave out answers faster than this.
    #[arg(long, default_value_t = 200.0, value_name = "MS", value_parser = non_negative)]
    fastest: f64,
    /// Score a classifier of the pictures in place of raters; it is no person, for development only.
    #[arg(long, conflicts_with = "answers")]
    stand_in: bool,
    /// Estimate the precision of so many raters, by simulation.
    #[arg(long, value_name = "RATERS", value_parser = at_least_one, conflicts_with_all = ["answers", "stand_in", "latex", "csv"])]
    plan: Option<usize>,
    /// Share to plan with [default: the paper's].
    #[arg(long, value_name = "SHARE", value_parser = share, requires = "plan")]
    expect: Option<f64>,
    /// Standard deviations between raters and between pairs to plan with, of a trial's.
    #[arg(long, value_name = "RATERS,PAIRS", value_delimiter = ',', num_args = 2, default_values_t = [0.5, 0.5], value_parser = non_negative)]
    deviations: Vec<f64>,
    /// Table to write in LaTeX.
    #[arg(long, value_name = "FILE.tex")]
    latex: Option<PathBuf>,
    /// Table to write with comma-separated values.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Report {
    rated_by: &'static str,
    #[serde(flatten)]
    score: StudyScore,
}

impl ScoreArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let design = StudyDesign::load(&self.study)?;
        if let Some(raters) = self.plan {
            let deviations = [self.deviations[0], self.deviations[1]];
            let rows = plan(&design, raters, self.expect, deviations)?;
            return console.result(&rows, || plan_text(&rows));
        }
        let mut answers = Vec::new();
        if self.stand_in {
            answers = stand_in_answers(&design, &self.study)?;
        } else {
            let mut paths = self.answers.clone();
            if paths.is_empty() {
                paths.push(self.study.join("answers.jsonl"));
            }
            for path in &paths {
                answers.extend(read_answers(&design, path)?);
            }
        }
        let options = ScoreOptions { catch_share: self.catch_share, fastest_ms: self.fastest };
        let score = StudyScore::new(&design, &answers, options);
        if score.cases.is_empty() {
            return Err(Error::message("no answers that count: expected answers to scored pairs"));
        }
        let rated_by = if self.stand_in { "stand-in classifier" } else { "people" };
        let report = Report { rated_by, score };
        if let Some(path) = &self.latex {
            files::write_text(path, &report.latex())?;
        }
        if let Some(path) = &self.csv {
            files::write_text(path, &report.csv())?;
        }
        console.result(&report, || report.text())
    }
}

fn plan_text(rows: &[PlannedPrecision]) -> String {
    let header = ["case", "raters", "answers/pair", "share %", "± %", "power", "detectable %"];
    let mut table = Table::new(header);
    for row in rows {
        table.row([
            row.case.name().to_owned(),
            row.raters.to_string(),
            format!("{:.1}", row.answers_per_pair),
            format!("{:.1}", 100.0 * row.share),
            format!("{:.1}", 196.0 * row.deviation),
            format!("{:.2}", row.power),
            format!("{:.1}", 100.0 * row.detectable),
        ]);
    }
    format!(
        "{}\n\npower: share of studies that tell the share from 50 %; detectable: distance from 50 % that \
         four of five find",
        table.text()
    )
}

impl Report {
    /// Cells of the table, one row a case: case, outfit, share, interval, alpha, paper.
    fn rows(&self) -> Vec<[String; 9]> {
        let percent = |share: f64| format!("{:.1}", 100.0 * share);
        let cases = self.score.cases.iter();
        cases
            .map(|case| {
                let ends = case.interval.map_or([None; 2], |i| [Some(i.low), Some(i.high)]);
                let [low, high] = ends.map(|end| end.map_or("–".into(), percent));
                [
                    case.case.name().to_owned(),
                    case.outfit.map_or("all".into(), |outfit| outfit.name().to_owned()),
                    case.pairs.to_string(),
                    case.answers.to_string(),
                    percent(case.share),
                    low,
                    high,
                    case.agreement.map_or("–".into(), |alpha| format!("{alpha:.2}")),
                    case.paper.map_or("–".into(), percent),
                ]
            })
            .collect()
    }

    fn text(&self) -> String {
        let header =
            ["case", "outfit", "pairs", "answers", "real %", "low", "high", "alpha", "paper %"];
        let mut table = Table::new(header);
        for row in self.rows() {
            table.row(row);
        }
        let score = &self.score;
        let mut text = format!(
            "{}\n\nrated by: {}; raters: {}; left chosen: {:.0} %; median time: {:.1} s\n50 %: generated \
             pictures cannot be told from real ones",
            table.text(),
            self.rated_by,
            score.raters,
            100.0 * score.left,
            score.median_ms / 1000.0
        );
        for rater in &score.excluded {
            let share = 100.0 * rater.catch_share;
            let _ =
                write!(text, "\nexcluded: {} ({share:.0} % of obvious pairs right)", rater.rater);
        }
        if score.too_fast > 0 {
            let _ = write!(text, "\nleft out: {} answers that were too fast", score.too_fast);
        }
        text
    }

    fn latex(&self) -> String {
        let mut text = format!(
            "% Generated pictures taken for real, %; rated by: {}\n\\begin{{tabular}}{{llrrrr}}\n\\toprule\n\
             case & outfit & taken for real & 95\\,\\% interval & $\\alpha$ & CAPE \\\\\n\\midrule\n",
            self.rated_by
        );
        for [case, outfit, _, _, share, low, high, alpha, paper] in self.rows() {
            let _ = writeln!(
                text,
                "{case} & {} & {share} & [{low}, {high}] & {alpha} & {paper} \\\\",
                outfit.replace('_', "\\_")
            );
        }
        text.push_str("\\bottomrule\n\\end{tabular}\n");
        text.replace('–', "--")
    }

    fn csv(&self) -> String {
        let mut text = String::from(
            "rated_by,case,outfit,pairs,answers,real_percent,low,high,alpha,paper_percent\n",
        );
        for row in self.rows() {
            let _ = writeln!(text, "{},{}", self.rated_by, row.join(",").replace('–', ""));
        }
        text
    }
}
