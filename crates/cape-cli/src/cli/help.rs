//! Help: the first page lists commands in groups by task; `-h` and `--help` of a command are the
//! same page: description, usage, options in a line each, and an example.

use std::fmt::Write as _;

use clap::{Arg, ArgAction, Command, CommandFactory, builder::Styles};

use super::Cli;

/// Commands of the first page by task.
pub(super) const GROUPS: [(&str, &[&str]); 7] = [
    ("First steps", &["demo"]),
    ("Data", &["data"]),
    ("Training and measuring", &["train", "eval", "table2", "study"]),
    ("Sampling and moving", &["sample", "vary", "redress", "animate", "view"]),
    ("Fitting", &["fit"]),
    ("Clothing layers", &["layer"]),
    ("Models and files", &["body", "model", "info"]),
];

/// Columns that descriptions are wrapped at.
const COLUMNS: usize = 100;

/// The commands with their help.
pub(crate) fn command() -> Command {
    let mut command = with_one_page(plain());
    let template = first_page(&command);
    command = command.help_template(template);
    command
}

/// The commands as they are declared.
pub(super) fn plain() -> Command {
    without_help_command(Cli::command())
}

fn without_help_command(command: Command) -> Command {
    command.disable_help_subcommand(true).mut_subcommands(without_help_command)
}

/// `--help` shows what `-h` does, with the description above the usage.
fn with_one_page(command: Command) -> Command {
    let description = command.get_long_about().map(ToString::to_string);
    let about = description.or_else(|| command.get_about().map(ToString::to_string));
    let text = wrapped(&about.unwrap_or_default());
    let example = example(&command);
    let page = format!("{text}\n\n{{usage-heading}} {{usage}}\n\n{{all-args}}\n\n{example}");
    command
        .long_about(None::<&'static str>)
        .help_template(page)
        .disable_help_flag(true)
        .arg(
            Arg::new("help")
                .short('h')
                .long("help")
                .action(ArgAction::HelpShort)
                .help("Print help")
                .display_order(usize::MAX - 1),
        )
        .mut_subcommands(with_one_page)
}

/// The example, kept out of `{after-help}`, which would wrap its lines.
fn example(command: &Command) -> String {
    command.get_after_help().map(ToString::to_string).unwrap_or_default()
}

/// The help's template with the list of commands, made from the commands themselves.
fn first_page(command: &Command) -> String {
    let styles = Styles::default();
    let (header, literal) = (styles.get_header(), styles.get_literal());
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    let mut page = format!("{about}\n\n{{usage-heading}} {{usage}}\n\n");
    for (title, names) in GROUPS {
        let _ = writeln!(page, "{header}{title}:{header:#}");
        for name in names {
            let Some(command) = command.find_subcommand(name) else { continue };
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(page, "  {literal}{name:<8}{literal:#}  {about}");
        }
        page.push('\n');
    }
    let _ = write!(page, "{header}Options:{header:#}\n{{options}}\n\n{}", example(command));
    page
}

fn wrapped(text: &str) -> String {
    let paragraphs = text.split("\n\n").map(|paragraph| {
        let mut lines = vec![String::new()];
        for word in paragraph.split_whitespace() {
            let line = lines.last().map_or(0, |line| line.chars().count());
            if line > 0 && line + 1 + word.chars().count() > COLUMNS {
                lines.push(String::new());
            }
            if let Some(line) = lines.last_mut() {
                if !line.is_empty() {
                    line.push(' ');
                }
                line.push_str(word);
            }
        }
        lines.join("\n")
    });
    paragraphs.collect::<Vec<_>>().join("\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn visible(command: &Command) -> Vec<&str> {
        let commands = command.get_subcommands().filter(|command| !command.is_hide_set());
        commands.map(Command::get_name).filter(|name| *name != "help").collect()
    }

    #[test]
    fn every_command_is_in_one_group_of_the_first_page() {
        let command = command();
        let commands = visible(&command);
        assert!(commands.len() <= 16, "{commands:?}");
        let listed: Vec<&str> =
            GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        for name in &commands {
            assert_eq!(listed.iter().filter(|listed| *listed == name).count(), 1, "{name}");
        }
        for name in listed {
            assert!(commands.contains(&name) || name == "view", "{name}");
        }
        let page = command.clone().render_help().to_string();
        for (title, _) in GROUPS {
            assert!(page.contains(&format!("{title}:")), "{page}");
        }
    }

    #[test]
    fn every_command_has_an_example() {
        let mut command = command();
        command.build();
        command.clone().debug_assert();
        each(&command, "cape", &mut |command, path| {
            let short = command.clone().render_help().to_string();
            let shown = |flag: &str| {
                let words = path.split(' ').chain([flag]);
                let Err(help) = super::command().try_get_matches_from(words) else {
                    panic!("{path} {flag}: no help")
                };
                help.to_string()
            };
            assert_eq!(shown("-h"), shown("--help"), "{path}");
            let example = short.split("Example").nth(1).unwrap_or_default();
            assert!(example.contains(path), "{path}: no example:\n{short}");
            for line in short.lines().filter(|line| !line.contains("cape ")) {
                assert!(!line.contains('{') || line.contains("{outfit}"), "{line}");
            }
        });
    }

    fn each(command: &Command, path: &str, check: &mut impl FnMut(&Command, &str)) {
        check(command, path);
        for inner in command.get_subcommands() {
            each(inner, &format!("{path} {}", inner.get_name()), check);
        }
    }
}
