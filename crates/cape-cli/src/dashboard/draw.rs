//! The dashboard's layout.

use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    symbols::Marker,
    text::{Line, Span},
    widgets::{Axis, Block, Chart, Dataset, Gauge, GraphType, Paragraph},
};

use super::{curve::Curve, state::DashboardState};
use crate::console::seconds;

const FAINT: Style = Style::new().fg(Color::DarkGray);
const BRIGHT: Style = Style::new().add_modifier(Modifier::BOLD);
const ACCENT: Color = Color::Cyan;
const SECOND: Color = Color::Yellow;
/// The least a chart can be read at.
const CHART_WIDTH: u16 = 22;
const CHART_HEIGHT: u16 = 7;

/// Draws everything that there is room for: progress first, then numbers, then curves.
pub(super) fn draw(frame: &mut Frame, state: &DashboardState) {
    let area = frame.area();
    let numbers = flowed(&numbers(state), area.width);
    let [title, bars, text, charts, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(2),
        Constraint::Length(numbers.len() as u16),
        Constraint::Fill(1),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(heading(state), title);
    draw_progress(frame, bars, state);
    frame.render_widget(Paragraph::new(numbers), text);
    draw_charts(frame, charts, state);
    frame.render_widget(footer(state), keys);
}

fn heading(state: &DashboardState) -> Line<'_> {
    Line::from(vec![
        Span::styled("cape train ", FAINT),
        Span::styled(&*state.title, BRIGHT.fg(ACCENT)),
        Span::styled(format!(" · {}", seconds(state.elapsed.as_secs_f64())), FAINT),
    ])
}

fn footer(state: &DashboardState) -> Line<'_> {
    if state.stopping {
        let text = "finishing the step and saving; Ctrl-C to stop at once";
        return Line::styled(text, BRIGHT.fg(SECOND));
    }
    let scale = if state.logarithmic { "linear" } else { "logarithmic" };
    let saved = state.checkpoint.as_ref().and_then(|path| path.file_name());
    let saved = saved.map_or(String::new(), |name| format!(" · saved {}", name.display()));
    Line::styled(format!("q stop and save · l {scale} scale{saved}"), FAINT)
}

fn draw_progress(frame: &mut Frame, area: Rect, state: &DashboardState) {
    let Some(now) = &state.now else {
        frame.render_widget(Line::styled("waiting for the first step", FAINT), area);
        return;
    };
    let left =
        |left: Option<f64>| left.map_or(String::new(), |left| format!(" · {} left", seconds(left)));
    let ((all, epoch), times) = (state.progress(), state.left());
    let [above, below] = Layout::vertical([Constraint::Length(1); 2]).areas(area);
    for (area, part, text, colour) in [
        (
            above,
            all,
            format!("epoch {}/{}{}", now.epoch, state.epochs, left(times.map(|(all, _)| all))),
            Color::Blue,
        ),
        (
            below,
            epoch,
            format!("step {}/{}{}", now.step, now.steps, left(times.map(|(_, epoch)| epoch))),
            Color::Green,
        ),
    ] {
        let style = Style::new().fg(colour).bg(Color::Black);
        let label = Span::styled(text, BRIGHT.fg(Color::White));
        frame.render_widget(Gauge::default().ratio(part).label(label).gauge_style(style), area);
    }
}

/// Current values by name.
fn numbers(state: &DashboardState) -> Vec<(&'static str, String)> {
    let mut numbers = Vec::new();
    if let Some(now) = &state.now {
        let losses = &now.losses;
        numbers.extend([
            ("reconstruction", short(losses.reconstruction)),
            ("edge", short(losses.edge)),
            ("KL", short(losses.kl)),
            ("regularisation", short(losses.regularisation)),
        ]);
        if state.adversarial {
            numbers.extend([
                ("generator", short(losses.gan_generator)),
                ("discriminator", short(losses.gan_discriminator)),
            ]);
            if let Some(accuracy) = state.curves.accuracy.last() {
                numbers.push(("discriminator accuracy", format!("{:.0} %", 100.0 * accuracy)));
            }
        }
    }
    if let Some(validation) = &state.validation {
        let (best, epoch) = validation.best;
        numbers.extend([
            ("validation", format!("{:.2} mm", validation.millimetres)),
            ("best", format!("{best:.2} mm (epoch {epoch})")),
            ("active units", validation.active_units.to_string()),
        ]);
    }
    if let Some(now) = &state.now {
        numbers.push(("rate", short(now.rate)));
    }
    if let Some(spent) = state.curves.seconds.last() {
        numbers.push(("step", seconds_of(spent)));
    }
    if let Some((megabytes, most)) = state.memory {
        numbers.push(("memory", format!("{megabytes:.0} MB (at most {most:.0})")));
    }
    numbers
}

/// Names and values in lines of at most `width` columns.
fn flowed(numbers: &[(&'static str, String)], width: u16) -> Vec<Line<'static>> {
    const GAP: &str = "   ";
    let mut lines: Vec<Line> = Vec::new();
    for (name, value) in numbers {
        let item = [Span::styled(format!("{name} "), FAINT), Span::styled(value.clone(), BRIGHT)];
        let needed = name.len() + 1 + value.chars().count();
        match lines.last_mut() {
            Some(line) if line.width() + GAP.len() + needed <= width as usize => {
                line.push_span(GAP);
                line.spans.extend(item);
            }
            _ => lines.push(Line::from_iter(item)),
        }
    }
    lines
}

/// Curves that share a chart, the unit along them, and whether a logarithm may be taken.
struct Panel<'a> {
    curves: Vec<(&'static str, &'a Curve)>,
    along: &'static str,
    loss: bool,
    /// Room beside its neighbours.
    share: u16,
}

fn draw_charts(frame: &mut Frame, area: Rect, state: &DashboardState) {
    let curves = &state.curves;
    let panel = |name, curve, along, share| Panel {
        curves: vec![(name, curve)],
        along,
        loss: false,
        share,
    };
    let upper = vec![
        Panel {
            curves: vec![("reconstruction", &curves.reconstruction), ("edge", &curves.edge)],
            along: "step",
            loss: true,
            share: 3,
        },
        Panel { loss: true, ..panel("validation, mm", &curves.validation, "epoch", 2) },
    ];
    let mut lower = Vec::new();
    if state.adversarial {
        lower.push(Panel {
            curves: vec![
                ("generator", &curves.generator),
                ("discriminator", &curves.discriminator),
            ],
            along: "step",
            loss: false,
            share: 3,
        });
    }
    lower.extend([
        panel("rate", &curves.rate, "step", 2),
        panel("seconds/step", &curves.seconds, "step", 2),
        panel("memory, MB", &curves.memory, "second", 2),
    ]);
    let rows = match area.height / CHART_HEIGHT {
        0 => return,
        1 => vec![upper],
        _ => vec![upper, lower],
    };
    let heights = Layout::vertical(rows.iter().map(|_| Constraint::Fill(1))).split(area);
    for (mut row, area) in rows.into_iter().zip(heights.iter()) {
        row.truncate((area.width / CHART_WIDTH) as usize);
        let widths = Layout::horizontal(row.iter().map(|panel| Constraint::Fill(panel.share)));
        for (panel, area) in row.iter().zip(widths.split(*area).iter()) {
            draw_panel(frame, *area, panel, panel.loss && state.logarithmic);
        }
    }
}

fn draw_panel(frame: &mut Frame, area: Rect, panel: &Panel, logarithmic: bool) {
    let colours = [ACCENT, SECOND];
    let shown = |(x, y): (f64, f64)| {
        if logarithmic { (y > 0.0).then(|| (x, y.log10())) } else { Some((x, y)) }
    };
    let points: Vec<Vec<(f64, f64)>> = panel
        .curves
        .iter()
        .map(|(_, curve)| curve.points().into_iter().filter_map(shown).collect())
        .collect();
    let mut title = vec![Span::raw(" ")];
    for ((name, _), colour) in panel.curves.iter().zip(colours) {
        title.extend([Span::styled(*name, Style::new().fg(colour)), Span::raw(" ")]);
    }
    let block = Block::bordered().border_style(FAINT).title(Line::from(title));
    let all = || points.iter().flatten().copied();
    let (Some((start, end)), Some((low, high))) =
        (range(all().map(|(x, _)| x)), range(all().map(|(_, y)| y)))
    else {
        frame.render_widget(Paragraph::new("no data yet").style(FAINT).block(block), area);
        return;
    };
    let datasets = points.iter().zip(colours).map(|(points, colour)| {
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(colour))
            .data(points)
    });
    let bounds = padded(low, high, logarithmic);
    let value = |y: f64| short(if logarithmic { 10f64.powf(y) } else { y });
    let [bottom, top] = bounds;
    let mut labels = vec![value(bottom), value(top)];
    if area.height > CHART_HEIGHT {
        labels.insert(1, value(f64::midpoint(bottom, top)));
    }
    let chart = Chart::new(datasets.collect())
        .block(block)
        .legend_position(None)
        .x_axis(
            Axis::default()
                .style(FAINT)
                .bounds(if start < end { [start, end] } else { [start - 0.5, end + 0.5] })
                .labels([format!("{} {start:.0}", panel.along), format!("{end:.0}")]),
        )
        .y_axis(Axis::default().style(FAINT).bounds(bounds).labels(labels));
    frame.render_widget(chart, area);
}

/// The least and the largest value.
fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |range, value| {
        let (low, high) = range.unwrap_or((value, value));
        Some((low.min(value), high.max(value)))
    })
}

/// Bounds with a little room around the curve, also around a flat one; what is never negative gets
/// no room below zero.
fn padded(low: f64, high: f64, logarithmic: bool) -> [f64; 2] {
    let room = (0.05 * (high - low)).max(0.01 * high.abs()).max(1e-9);
    let floor = if low >= 0.0 && !logarithmic { 0.0 } else { f64::NEG_INFINITY };
    [(low - room).max(floor), high + room]
}

/// A number in few characters: three or four digits, or a power of ten.
fn short(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        return "0".into();
    }
    if !(1e-3..1e5).contains(&size) {
        return format!("{value:.1e}");
    }
    let magnitude = size.log10().floor() as i32;
    let decimals = if magnitude < 0 { 2 - magnitude } else { 3 - magnitude };
    format!("{value:.*}", decimals.max(0) as usize)
}

fn seconds_of(step: f64) -> String {
    if step < 1.0 { format!("{:.0} ms", 1e3 * step) } else { format!("{step:.2} s") }
}

#[cfg(test)]
mod tests {
    use ratatui::{Terminal, backend::TestBackend};

    use super::*;
    use crate::dashboard::state::tests::busy;

    /// Content of a terminal of this size, a string per line.
    fn screen(state: &DashboardState, width: u16, height: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, state)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
        (0..height).map(|y| line(y).trim_end().to_owned()).collect()
    }

    /// The titles in a line of the charts' upper borders.
    fn titles(line: &str) -> Vec<&str> {
        line.split(['┌', '─', '┐']).filter(|title| !title.is_empty()).collect()
    }

    #[test]
    fn a_large_terminal_shows_everything() {
        let screen = screen(&busy(), 120, 40);
        let bar = |filled: usize, label: &str, column: usize| {
            let filled = "█".repeat(filled);
            format!("{filled}{}{label}", " ".repeat(column - filled.chars().count()))
        };
        let expected = [
            "cape train runs/male · 60 s".to_owned(),
            bar(5, "epoch 3/60 · 24 min 00 s left", 45),
            bar(48, " step 20/50 · 15 s left", 48),
            "reconstruction 0.208   edge 0.0525   KL 42.00   regularisation 0   generator 0.839   \
             discriminator 1.231"
                .to_owned(),
            "discriminator accuracy 61 %   validation 10.00 mm   best 10.00 mm (epoch 2)   active units 7   \
             rate 0.00480   step 500 ms"
                .to_owned(),
            "memory 920 MB (at most 920)".to_owned(),
        ];
        assert_eq!(screen[..6], expected, "\n{}", screen.join("\n"));
        assert_eq!(titles(&screen[6]), [" reconstruction edge ", " validation, mm "]);
        assert!(
            screen[21].contains("│step 1") && screen[21].contains("│epoch 1"),
            "\n{}",
            screen.join("\n")
        );
        assert_eq!(
            titles(&screen[23]),
            [" generator discriminator ", " rate ", " seconds/step ", " memory, MB "]
        );
        assert_eq!(screen[39], "q stop and save · l logarithmic scale · saved step-00000100");
        // Every chart has a curve.
        for (rows, columns) in [(7..21, 1), (24..37, 3)] {
            for column in 0..=columns {
                let from = 120 * column / (columns + 1) + 9;
                let drawn = rows.clone().any(|row: usize| {
                    screen[row].chars().skip(from).take(20).any(|c| ('⠁'..='⣿').contains(&c))
                });
                assert!(drawn, "{rows:?} {column}\n{}", screen.join("\n"));
            }
        }
    }

    #[test]
    fn a_small_terminal_shows_what_matters_most() {
        let screen = screen(&busy(), 60, 20);
        assert_eq!(
            screen[3..8],
            [
                "reconstruction 0.208   edge 0.0525   KL 42.00",
                "regularisation 0   generator 0.839   discriminator 1.231",
                "discriminator accuracy 61 %   validation 10.00 mm",
                "best 10.00 mm (epoch 2)   active units 7   rate 0.00480",
                "step 500 ms   memory 920 MB (at most 920)",
            ],
            "\n{}",
            screen.join("\n")
        );
        assert_eq!(titles(&screen[8]), [" reconstruction edge ", " validation, mm "]);
        assert_eq!(screen[19], "q stop and save · l logarithmic scale · saved step-00000100");
    }

    #[test]
    fn losses_are_drawn_on_a_logarithmic_scale_if_wanted() {
        let mut state = busy();
        let linear = screen(&state, 120, 40);
        state.logarithmic = true;
        let logarithmic = screen(&state, 120, 40);
        assert!(linear[19].starts_with("│0 "), "{}", linear[19]);
        assert!(!logarithmic[6..22].iter().any(|line| line.starts_with("│0 ")));
        assert!(logarithmic[39].contains("l linear scale"));
        // Only losses: the rate's chart is as it was.
        let rate = |screen: &[String]| screen[24].chars().skip(41).take(26).collect::<String>();
        assert_eq!(rate(&linear), rate(&logarithmic));
    }

    #[test]
    fn a_model_without_a_discriminator_has_no_chart_of_it() {
        let mut state = busy();
        state.adversarial = false;
        let text = screen(&state, 120, 40).join("\n");
        assert!(!text.contains("discriminator") && !text.contains("judged"), "{text}");
    }

    #[test]
    fn before_the_first_step_and_after_the_wish_to_stop_it_says_so() {
        let mut state = DashboardState::new("run", 3);
        assert_eq!(screen(&state, 60, 20)[1], "waiting for the first step");
        state.stopping = true;
        assert!(screen(&state, 60, 20)[19].starts_with("finishing the step and saving"));
    }

    #[test]
    fn no_size_is_too_small() {
        let state = busy();
        for width in (1..140).step_by(7) {
            for height in 1..48 {
                screen(&state, width, height);
            }
        }
    }

    #[test]
    fn numbers_are_short() {
        let cases = [0.0, 1.0, -12.345, 0.0525, 0.001, 1e-4, 99999.0, 1e6];
        let said = cases.map(short);
        assert_eq!(said, ["0", "1.000", "-12.35", "0.0525", "0.00100", "1.0e-4", "99999", "1.0e6"]);
        assert_eq!(padded(0.0, 1.0, false)[0], 0.0);
        assert!(padded(2.0, 2.0, false)[0] < 2.0 && padded(0.5, 1.0, true)[0] < 0.5);
    }
}
