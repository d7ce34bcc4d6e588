//! The report of `cape table2`.

use std::{fs, path::PathBuf, sync::OnceLock};

use cape::render::Image;

use crate::{
    browser::{Browser, Rect, Scheme, Shot, View},
    keep,
    support::Packed,
};

/// The methods' labels and classes of their rows.
const METHODS: [(&str, &str); 3] = [("mean shape", ""), ("PCA", ""), ("CAPE", "reference")];
/// Tall enough for the whole report.
const WIDE: View = View { width: 1280, height: 7000, scheme: Scheme::Light };

/// A table of three methods, made once by the command itself.
fn report() -> PathBuf {
    static TABLE: OnceLock<Packed> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        let data = Packed::new();
        data.run(
            "table2 --data @/packed --out @/table --preset tiny --epochs 1 --rows mean,pca,cape",
        )
        .succeeded();
        data
    });
    table.at("table/report.html")
}

/// The report in `view`, if there is a browser.
fn shown(name: &str, view: View) -> Option<Shot> {
    let browser = Browser::find()?;
    let shot = browser.show(&fs::read_to_string(report()).unwrap(), view);
    keep(name, &shot.image);
    Some(shot)
}

/// Checks that hold in every view.
fn check(shot: &Shot, view: View) {
    assert_eq!((shot.image.width(), shot.image.height()), (view.width, view.height));
    assert_eq!(shot.page.console_errors, [""; 0]);
    assert!(shot.page.title.contains("table 2"), "{}", shot.page.title);

    let first = &shot.page.tables[0];
    let cells = first.header.len();
    assert!(cells > 3, "{:?}", first.header);
    assert_eq!(first.rows.len(), METHODS.len());
    for (row, (label, class)) in first.rows.iter().zip(METHODS) {
        assert_eq!((row.cells[0].as_str(), row.class.as_str()), (label, class));
        assert_eq!(row.cells.len(), cells);
        assert!(row.cells.iter().all(|cell| !cell.trim().is_empty()), "{:?}", row.cells);
        assert!(colours(&shot.image, row.rect) > 8, "{label}: nothing is written");
    }
    // By outfit and by sequence.
    assert!(shot.page.tables.iter().all(|table| table.rows.len() == METHODS.len()));

    assert!(!shot.page.images.is_empty());
    for image in &shot.page.images {
        assert!(image.width > 100 && image.height > 100, "{image:?}");
        assert!(!image.alt.is_empty(), "an image without a description");
        let (rect, proportion) = (image.rect, image.width as f64 / image.height as f64);
        assert!((rect.width / rect.height / proportion - 1.0).abs() < 0.05, "{image:?}");
        assert!(colours(&shot.image, rect) > 50, "nothing is to be seen: {image:?}");
    }
}

#[test]
fn the_report_shows_its_tables_and_figures() {
    let Some(shot) = shown("wide", WIDE) else { return };
    check(&shot, WIDE);
    assert!(shot.page.overflow <= 0.0, "the page is {} px too wide", shot.page.overflow);
    // The error maps are those that were written, not some picture or other.
    let maps = Image::load(report().with_file_name("error_maps.png")).unwrap();
    let size = (f64::from(maps.width()), f64::from(maps.height()));
    let drawn = shot
        .page
        .images
        .iter()
        .find(|image| (image.width as f64, image.height as f64) == size)
        .expect("an image of the size of error_maps.png");
    let whole = Rect { x: 0.0, y: 0.0, width: size.0, height: size.1 };
    let (found, expected) = (mean(&shot.image, drawn.rect), mean(&maps, whole));
    for channel in 0..3 {
        let difference = (found[channel] - expected[channel]).abs();
        assert!(difference < 3.0, "{found:?} is drawn of {expected:?}");
    }
}

#[test]
fn the_report_is_readable_on_a_telephone() {
    let view = View { width: 420, ..WIDE };
    let Some(shot) = shown("narrow", view) else { return };
    check(&shot, view);
}

#[test]
fn the_report_does_not_scroll_sideways_on_a_telephone() {
    let view = View { width: 420, ..WIDE };
    let Some(shot) = shown("narrow", view) else { return };
    assert!(shot.page.overflow <= 0.0, "the page is {} px too wide", shot.page.overflow);
}

#[test]
fn the_report_is_dark_where_that_is_preferred() {
    let view = View { scheme: Scheme::Dark, ..WIDE };
    let Some(shot) = shown("dark", view) else { return };
    check(&shot, view);
    let luma = |[r, g, b, _]: [u8; 4]| {
        0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
    };
    let corner = luma(shot.image.get(2, 2).unwrap());
    assert!(corner < 60.0, "the page is of luma {corner}");
    for row in &shot.page.tables[0].rows {
        let brightest = pixels(&shot.image, row.rect).map(luma).fold(0.0, f64::max);
        assert!(brightest > 150.0, "text of luma {brightest} at most: {:?}", row.cells);
    }
}

/// The pixels of `image` inside `rect`.
fn pixels(image: &Image, rect: Rect) -> impl Iterator<Item = [u8; 4]> {
    let range = |start: f64, length: f64| start.ceil() as u32..(start + length).floor() as u32;
    let columns = range(rect.x, rect.width);
    range(rect.y, rect.height)
        .flat_map(move |y| columns.clone().map(move |x| (x, y)))
        .filter_map(|(x, y)| image.get(x, y))
}

/// Number of different colours inside `rect`.
fn colours(image: &Image, rect: Rect) -> usize {
    pixels(image, rect).collect::<std::collections::HashSet<_>>().len()
}

fn mean(image: &Image, rect: Rect) -> [f64; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for pixel in pixels(image, rect) {
        for (sum, value) in sum.iter_mut().zip(pixel) {
            *sum += f64::from(value);
        }
        count += 1.0;
    }
    sum.map(|sum| sum / count)
}
