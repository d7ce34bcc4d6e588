use crate::{Error, Image, Result, TextSize};

/// Image on a contact sheet with its label.
///
/// ```
/// use cape_render::{Image, Tile, contact_sheet};
///
/// let picture = Image::new(40, 30, [90, 120, 150, 255])?;
/// let tile = |label: &str| Tile { image: picture.clone(), label: label.into() };
/// let sheet = contact_sheet(&[tile("bare"), tile("clothed")], 2, None)?;
/// // Two cells between gaps of 8 pixels; 16 rows for a label and a gap below each.
/// assert_eq!((sheet.width(), sheet.height()), (8 + 2 * 48, 8 + 30 + 8 + 16 + 8));
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Tile {
    /// Image.
    pub image: Image,
    /// Label of one line, truncated to the width of the image; may be empty.
    pub label: String,
}

/// Arranges `tiles` in a grid of `columns` columns, row by row, under an optional `title`. Cells have
/// the size of the largest image.
///
/// # Errors
/// If there is no tile or no column, or the sheet would be too large.
pub fn contact_sheet(tiles: &[Tile], columns: usize, title: Option<&str>) -> Result<Image> {
    const GAP: u32 = 8;
    const PAPER: [u8; 4] = [250, 250, 251, 255];
    const INK: [u8; 3] = [40, 42, 46];
    if tiles.is_empty() || columns == 0 {
        return Err(Error::Argument(
            "contact sheet: expected at least one image and one column".into(),
        ));
    }
    let columns = columns.min(tiles.len());
    let rows = tiles.len().div_ceil(columns);
    let cell_width = tiles.iter().map(|tile| tile.image.width()).max().unwrap_or(1);
    let cell_height = tiles.iter().map(|tile| tile.image.height()).max().unwrap_or(1);
    let labelled = tiles.iter().any(|tile| !tile.label.is_empty());
    let label_height = if labelled { TextSize::Small.height() + GAP } else { 0 };
    let head = if title.is_some() { TextSize::Large.height() + GAP } else { 0 };

    let side = |count: usize, size: u32| count as u64 * u64::from(size + GAP) + u64::from(GAP);
    let width = side(columns, cell_width);
    let height = side(rows, cell_height + label_height) + u64::from(head);
    let clamp = |length: u64| u32::try_from(length).unwrap_or(u32::MAX);
    let mut sheet = Image::new(clamp(width), clamp(height), PAPER)?;
    if let Some(title) = title {
        sheet.text(title, i64::from(GAP), i64::from(GAP), TextSize::Large, INK);
    }
    for (index, Tile { image, label }) in tiles.iter().enumerate() {
        let x = GAP + (index % columns) as u32 * (cell_width + GAP);
        let y = GAP + head + (index / columns) as u32 * (cell_height + label_height + GAP);
        let left = i64::from(x + (cell_width - image.width()) / 2);
        sheet.draw(image, left, i64::from(y + (cell_height - image.height()) / 2));
        let letters = (cell_width / TextSize::Small.width("x").max(1)) as usize;
        let label: String = label.chars().take(letters).collect();
        let left = x + cell_width.saturating_sub(TextSize::Small.width(&label)) / 2;
        let top = y + cell_height + GAP / 2;
        sheet.text(&label, i64::from(left), i64::from(top), TextSize::Small, INK);
    }
    Ok(sheet)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_placed_row_by_row() {
        let colours = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]];
        let tiles = colours.map(|colour| Tile {
            image: Image::new(20, 10, colour).unwrap(),
            label: String::new(),
        });
        let sheet = contact_sheet(&tiles, 2, None).unwrap();
        assert_eq!((sheet.width(), sheet.height()), (8 + 2 * 28, 8 + 2 * 18));
        assert_eq!(sheet.get(8, 8), Some(colours[0]));
        assert_eq!(sheet.get(36 + 19, 17), Some(colours[1]));
        assert_eq!(sheet.get(8, 26), Some(colours[2]));
        assert_eq!(sheet.get(30, 12), sheet.get(0, 0));
    }

    #[test]
    fn an_empty_sheet_is_an_error() {
        assert!(contact_sheet(&[], 2, None).is_err());
    }
}
