//! Tables on a terminal: columns of one width, numbers to the right.

/// Draws a table; the first row is the head.
pub fn draw(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let is_number = |cell: &str| cell == "-" || cell.parse::<f64>().is_ok();
    let right: Vec<bool> = (0..columns)
        .map(|column| {
            rows.len() > 1 && rows[1..].iter().filter_map(|row| row.get(column)).all(|cell| is_number(cell))
        })
        .collect();
    let mut text = String::new();
    for (r, row) in rows.iter().enumerate() {
        let cells: Vec<String> =
            row.iter()
                .enumerate()
                .map(|(c, cell)| {
                    if right[c] { format!("{cell:>0$}", widths[c]) } else { format!("{cell:<0$}", widths[c]) }
                })
                .collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
        if r == 0 {
            text.push_str(&widths.iter().map(|w| "-".repeat(*w)).collect::<Vec<_>>().join("  "));
            text.push('\n');
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_to_the_right_and_words_to_the_left() {
        let rows = [["method", "psnr_db"], ["EDI", "9.5"], ["ours", "12.25"]]
            .map(|row| row.map(String::from).to_vec());
        assert_eq!(draw(&rows), "method  psnr_db\n------  -------\nEDI         9.5\nours      12.25\n");
    }
}
