//! Output: results on standard output, progress and notes on standard error.

use std::io::{IsTerminal, Write};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;

use crate::error::{Error, Result};

/// Output of a command.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Console {
    json: bool,
    quiet: bool,
}

impl Console {
    pub(crate) const fn new(json: bool, quiet: bool) -> Self {
        Self { json, quiet }
    }

    /// Prints a command's result, as JSON with `--json`, else as text.
    pub(crate) fn result<T: Serialize>(self, value: &T, text: impl FnOnce() -> String) -> Result {
        let text = if self.json {
            serde_json::to_string_pretty(value)
                .map_err(|error| Error::message(format!("result: {error}")))?
        } else {
            text()
        };
        let mut out = std::io::stdout().lock();
        writeln!(out, "{text}").and_then(|()| out.flush()).map_err(Error::output)
    }

    /// Prints a note on standard error, unless `--quiet`.
    pub(crate) fn note(self, text: &str) {
        if !self.quiet {
            eprintln!("{text}");
        }
    }

    /// True if progress bars are shown.
    pub(crate) fn shows_bars(self) -> bool {
        !self.quiet && std::io::stderr().is_terminal()
    }

    /// A bar counting `unit`s under the heading `what`.
    pub(crate) fn bar(self, what: &str, unit: &str) -> ProgressBar {
        let target = if self.shows_bars() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let template = format!(
            "{{prefix:<10}} {{bar:28.cyan/dim}} {{pos}}/{{len}} {unit} · {{elapsed}} · {{eta}} left \
             {{wide_msg}}"
        );
        let style = ProgressStyle::with_template(&template)
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("━╸─");
        ProgressBar::with_draw_target(Some(0), target)
            .with_style(style)
            .with_prefix(what.to_owned())
    }

    /// Runs `work` with a bar that its progress callback moves.
    pub(crate) fn while_showing<T>(
        self,
        what: &str,
        unit: &str,
        work: impl FnOnce(&mut dyn FnMut(usize, usize)) -> T,
    ) -> T {
        let bar = self.bar(what, unit);
        let result = work(&mut |done, total| {
            bar.set_length(total as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        result
    }
}

/// A duration in seconds, minutes, hours or days.
pub(crate) fn seconds(seconds: f64) -> String {
    let whole = seconds as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..120 => format!("{seconds:.0} s"),
        120..7200 => format!("{} min {:02} s", whole / 60, whole % 60),
        7200..172_800 => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
        _ => format!("{:.1} days", seconds / 86400.0),
    }
}
