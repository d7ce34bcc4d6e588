use crate::{Image, Result, TextSize};

/// Colours of the series in order, distinguishable with common colour blindness.
const COLOURS: [[u8; 3]; 7] = [
    [31, 105, 180],
    [214, 96, 20],
    [20, 145, 105],
    [190, 60, 120],
    [120, 94, 190],
    [150, 120, 20],
    [90, 90, 90],
];
/// Lengths of dash and gap, pixels, for series that repeat a colour.
const DASH: [f64; 2] = [7.0, 5.0];
const INK: [u8; 3] = [50, 52, 56];
const GRID: [u8; 3] = [222, 224, 228];

/// Line of a plot.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend; not listed if empty.
    pub name: String,
    /// Points (x, y) in order; the line breaks at non-finite values.
    pub points: Vec<(f64, f64)>,
}

/// Line plot of several series.
///
/// ```
/// use cape_render::{Plot, Series};
///
/// let loss = Series {
///     name: "training".into(),
///     points: (0..50).map(|epoch| (epoch.into(), (-0.1 * f64::from(epoch)).exp())).collect(),
/// };
/// let plot = Plot {
///     title: "loss".into(),
///     x_label: "epoch".into(),
///     y_label: "L1".into(),
///     log_y: true,
///     series: vec![loss],
/// };
/// let image = plot.draw(320, 240)?;
/// assert_eq!((image.width(), image.height()), (320, 240));
/// // The smallest width is 160 pixels.
/// assert_eq!(plot.draw(20, 20)?.width(), 160);
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Plot {
    /// Title above the plot.
    pub title: String,
    /// Label of the x axis.
    pub x_label: String,
    /// Label of the y axis.
    pub y_label: String,
    /// Use a logarithmic y axis, on which non-positive values break the line.
    pub log_y: bool,
    /// Series, drawn in order.
    pub series: Vec<Series>,
}

/// Axis with its range and its position in the image.
struct Axis {
    low: f64,
    high: f64,
    log: bool,
    /// Pixel positions of `low` and `high`.
    from: f64,
    to: f64,
}

impl Axis {
    /// Axis of the range of the finite `values` with a relative margin `room`.
    fn fit(values: impl Iterator<Item = f64>, log: bool, room: f64, pixels: [f64; 2]) -> Self {
        let usable = values.filter(|v| v.is_finite() && (!log || *v > 0.0));
        let scaled = usable.map(|v| if log { v.log10() } else { v });
        let (mut low, mut high) =
            scaled.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if high - low < 1e-9 * low.abs().max(high.abs()).max(1e-12) {
            let half = if log { 0.5 } else { low.abs().max(1e-12) * 0.5 };
            (low, high) = (low - half, high + half);
        }
        let margin = room * (high - low);
        Self { low: low - margin, high: high + margin, log, from: pixels[0], to: pixels[1] }
    }

    /// Pixel position of `value`; `None` if it is not finite or has no logarithm.
    fn position(&self, value: f64) -> Option<f64> {
        let scaled = if self.log { value.log10() } else { value };
        let t = (scaled - self.low) / (self.high - self.low);
        scaled.is_finite().then_some(self.from + t * (self.to - self.from))
    }

    /// Tick values and labels, about `about` of them.
    fn ticks(&self, about: f64) -> Vec<(f64, String)> {
        if self.log {
            let decades = self.high - self.low;
            let factors: &[f64] = if decades > 3.0 {
                &[1.0]
            } else if decades > 0.8 {
                &[1.0, 2.0, 5.0]
            } else {
                &[1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
            };
            let skip = (decades / about).ceil().max(1.0) as i64;
            let range = self.low.floor() as i64..=self.high.ceil() as i64;
            return range
                .filter(|decade| decade.rem_euclid(skip) == 0)
                .flat_map(|decade| factors.iter().map(move |f| f * 10_f64.powi(decade as i32)))
                .filter(|value| (self.low..=self.high).contains(&value.log10()))
                .map(|value| (value, format_tick(value, value)))
                .collect();
        }
        let rough = (self.high - self.low) / about;
        let power = 10_f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0]
            .map(|factor| factor * power)
            .into_iter()
            .find(|step| *step >= rough)
            .unwrap_or(rough);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|i| (i as f64 * step, format_tick(i as f64 * step, step))).collect()
    }
}

/// Formats `value` with the digits of `step`.
fn format_tick(value: f64, step: f64) -> String {
    let largest = value.abs().max(step);
    if value == 0.0 {
        "0".into()
    } else if !(1e-4..1e6).contains(&largest) {
        let text = format!("{value:.1e}");
        text.replace(".0e", "e")
    } else {
        let digits = (0..8).find(|&d| {
            let scaled = step * 10_f64.powi(d);
            (scaled - scaled.round()).abs() < 1e-6 * scaled
        });
        format!("{value:.*}", digits.unwrap_or(8) as usize)
    }
}

impl Plot {
    /// Draws the plot at a size of at least 160×120 pixels.
    pub fn draw(&self, width: u32, height: u32) -> Result<Image> {
        let (width, height) = (width.max(160), height.max(120));
        let mut image = Image::new(width, height, [255; 4])?;
        let (left, top) = (76.0, if self.title.is_empty() { 14.0 } else { 44.0 });
        let (right, bottom) = (f64::from(width) - 18.0, f64::from(height) - 52.0);
        let all = || self.series.iter().flat_map(|series| series.points.iter());
        let x_axis = Axis::fit(all().map(|p| p.0), false, 0.0, [left, right]);
        let y_axis = Axis::fit(all().map(|p| p.1), self.log_y, 0.05, [bottom, top]);

        self.frame(&mut image, &x_axis, &y_axis);
        for (series, style) in self.series.iter().zip(line_styles()) {
            let line: Vec<_> = series
                .points
                .iter()
                .map(|&(x, y)| Some((x_axis.position(x)?, y_axis.position(y)?)))
                .collect();
            style.stroke(&mut image, line, 2.0);
        }
        self.legend(&mut image, right, top);
        Ok(image)
    }

    fn frame(&self, image: &mut Image, x_axis: &Axis, y_axis: &Axis) {
        let small = TextSize::Small;
        let (left, right, top, bottom) = (x_axis.from, x_axis.to, y_axis.to, y_axis.from);
        for (value, label) in y_axis.ticks((bottom - top) / 55.0) {
            let Some(y) = y_axis.position(value) else { continue };
            let y = y.round() + 0.5;
            stroke(image, &[Some((left, y)), Some((right, y))], 1.0, GRID);
            let x = left as i64 - i64::from(small.width(&label)) - 7;
            image.text(&label, x, y as i64 - 8, small, INK);
        }
        for (value, label) in x_axis.ticks((right - left) / 90.0) {
            let Some(x) = x_axis.position(value) else { continue };
            let x = x.round() + 0.5;
            stroke(image, &[Some((x, top)), Some((x, bottom))], 1.0, GRID);
            let start = x as i64 - i64::from(small.width(&label)) / 2;
            image.text(&label, start, bottom as i64 + 6, small, INK);
        }
        let corner = [(left, top), (left, bottom), (right, bottom)];
        stroke(image, &corner.map(|(x, y)| Some((x.round() + 0.5, y.round() + 0.5))), 1.2, INK);

        let centred = |from: f64, to: f64, width: u32| ((from + to) as i64 - i64::from(width)) / 2;
        let x = centred(left, right, small.width(&self.x_label));
        image.text(&self.x_label, x, bottom as i64 + 28, small, INK);
        let y = centred(top, bottom, 0) + i64::from(small.width(&self.y_label)) / 2;
        image.text_upwards(&self.y_label, 3, y, small, INK);
        let x = centred(left, right, TextSize::Large.width(&self.title));
        image.text(&self.title, x, 10, TextSize::Large, INK);
    }

    fn legend(&self, image: &mut Image, right: f64, top: f64) {
        let small = TextSize::Small;
        let named = || self.series.iter().zip(line_styles()).filter(|s| !s.0.name.is_empty());
        let Some(widest) = named().map(|(series, _)| small.width(&series.name)).max() else {
            return;
        };
        let x = right as i64 - i64::from(widest) - 48;
        let height = 20 * named().count() as i64 + 8;
        for row in 0..height {
            for column in 0..i64::from(widest) + 42 {
                image.blend(x + column, top as i64 + 4 + row, [255; 3], 0.85);
            }
        }
        for (row, (series, style)) in named().enumerate() {
            let y = top as i64 + 8 + 20 * row as i64;
            let middle = y as f64 + 8.5;
            let start = x as f64 + 6.0;
            style.stroke(image, vec![Some((start, middle)), Some((start + 22.0, middle))], 2.5);
            image.text(&series.name, x + 36, y, small, INK);
        }
    }
}

/// Styles of the series in order: all colours solid, then all colours dashed.
fn line_styles() -> impl Iterator<Item = LineStyle> {
    let styles = |dashed| COLOURS.map(|colour| LineStyle { colour, dashed });
    [styles(false), styles(true)].into_iter().flatten().cycle()
}

/// Colour and dashing of a line.
#[derive(Debug, Clone, Copy)]
struct LineStyle {
    colour: [u8; 3],
    dashed: bool,
}

impl LineStyle {
    fn stroke(self, image: &mut Image, line: Vec<Option<(f64, f64)>>, width: f64) {
        let line = if self.dashed { dashes(&line) } else { line };
        stroke(image, &line, width, self.colour);
    }
}

/// Cuts a line into dashes along its length.
fn dashes(line: &[Option<(f64, f64)>]) -> Vec<Option<(f64, f64)>> {
    let mut cut = Vec::new();
    let (mut on, mut left) = (true, DASH[0]);
    for pair in line.windows(2) {
        let [Some(from), Some(to)] = *pair else {
            cut.push(None);
            continue;
        };
        let length = (to.0 - from.0).hypot(to.1 - from.1);
        let at = |distance: f64| {
            let t = distance / length;
            Some((from.0 + t * (to.0 - from.0), from.1 + t * (to.1 - from.1)))
        };
        let mut distance = 0.0;
        while distance < length {
            let end = (distance + left).min(length);
            if on {
                cut.extend([at(distance), at(end)]);
            }
            left -= end - distance;
            distance = end;
            if left <= 1e-9 {
                on = !on;
                left = DASH[usize::from(!on)];
                cut.push(None);
            }
        }
    }
    cut
}

/// Draws an antialiased line with round joins; `None` breaks it.
fn stroke(image: &mut Image, line: &[Option<(f64, f64)>], width: f64, colour: [u8; 3]) {
    let (columns, rows) = (image.width() as usize, image.height() as usize);
    let mut cover = vec![0_f32; columns * rows];
    let reach = width * 0.5 + 1.0;
    for pair in line.windows(2) {
        let [Some(a), Some(b)] = pair else { continue };
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let length = (dx * dx + dy * dy).max(1e-12);
        let span = |a: f64, b: f64, limit: usize| {
            let low = (a.min(b) - reach).max(0.0) as usize;
            low..((a.max(b) + reach).max(0.0) as usize + 1).min(limit)
        };
        for row in span(a.1, b.1, rows) {
            let y = row as f64 + 0.5 - a.1;
            for column in span(a.0, b.0, columns) {
                let x = column as f64 + 0.5 - a.0;
                let t = ((x * dx + y * dy) / length).clamp(0.0, 1.0);
                let distance = (x - t * dx).hypot(y - t * dy);
                let opacity = (width * 0.5 + 0.5 - distance).clamp(0.0, 1.0) as f32;
                let pixel = &mut cover[row * columns + column];
                *pixel = pixel.max(opacity);
            }
        }
    }
    for (i, &opacity) in cover.iter().enumerate() {
        if opacity > 0.0 {
            image.blend((i % columns) as i64, (i / columns) as i64, colour, opacity);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(low: f64, high: f64, log: bool) -> Axis {
        Axis::fit([low, high].into_iter(), log, 0.0, [0.0, 100.0])
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let labels = |axis: Axis| -> Vec<String> {
            axis.ticks(5.0).into_iter().map(|(_, label)| label).collect()
        };
        assert_eq!(labels(axis(0.0, 10.0, false)), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(axis(-0.013, 0.042, false)), ["0", "0.02", "0.04"]);
        assert_eq!(labels(axis(0.01, 1000.0, true)), ["0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(labels(axis(3.0, 30.0, true)), ["5", "10", "20"]);
    }

    #[test]
    fn an_axis_of_equal_or_no_values_still_has_extent() {
        for axis in [axis(3.0, 3.0, false), axis(0.0, 0.0, false), axis(f64::NAN, -1.0, true)] {
            assert!(axis.high > axis.low);
            assert!(!axis.ticks(5.0).is_empty());
        }
    }

    #[test]
    fn a_horizontal_stroke_covers_its_width_exactly() {
        let mut image = Image::new(20, 9, [255; 4]).unwrap();
        stroke(&mut image, &[Some((-5.0, 4.5)), Some((30.0, 4.5))], 2.0, [0; 3]);
        let column: Vec<u8> = (0..9).map(|y| image.get(10, y).unwrap()[0]).collect();
        assert_eq!(column, [255, 255, 255, 128, 0, 128, 255, 255, 255]);
    }

    #[test]
    fn dashes_go_on_around_corners_and_stop_at_breaks() {
        let line = [Some((0.0, 0.0)), Some((4.0, 0.0)), Some((4.0, 10.0)), None, Some((9.0, 9.0))];
        let cut = dashes(&line);
        let expected = [
            Some((0.0, 0.0)),
            Some((4.0, 0.0)),
            Some((4.0, 0.0)),
            Some((4.0, 3.0)),
            None,
            None,
            Some((4.0, 8.0)),
            Some((4.0, 10.0)),
            None,
            None,
        ];
        assert_eq!(cut, expected);
        let styles: Vec<LineStyle> = line_styles().take(2 * COLOURS.len() + 1).collect();
        assert!(!styles[COLOURS.len() - 1].dashed && styles[COLOURS.len()].dashed);
        assert!(!styles[2 * COLOURS.len()].dashed);
    }

    #[test]
    fn a_line_breaks_at_values_that_cannot_be_shown() {
        let points = vec![(0.0, 1.0), (1.0, 1.0), (2.0, f64::NAN), (3.0, -1.0), (4.0, 1.0)];
        let plot = Plot {
            log_y: true,
            series: vec![Series { name: String::new(), points }],
            ..Plot::default()
        };
        let image = plot.draw(400, 200).unwrap();
        let drawn = |from: u32, to: u32| {
            (from..to)
                .flat_map(|x| (0..200).map(move |y| (x, y)))
                .filter(|&(x, y)| image.get(x, y).is_some_and(|p| p[..3] == COLOURS[0]))
                .count()
        };
        assert!(drawn(90, 140) > 40);
        assert_eq!(drawn(240, 395), 0);
    }
}
