//! Tables: on the terminal, row by row as measurements come in, and in Markdown.

use std::fmt::Write;

/// A column's heading, with its least width on the terminal.
#[derive(Clone, Copy, Debug)]
pub enum Column {
    /// Flush left.
    Text(&'static str, usize),
    /// Flush right.
    Number(&'static str, usize),
}

/// The columns of a table.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a>(
    /// From left to right.
    pub &'a [Column],
);

impl Column {
    fn head(self) -> &'static str {
        match self {
            Column::Text(head, _) | Column::Number(head, _) => head,
        }
    }
}

impl Table<'_> {
    /// The headings, as a line of the terminal.
    pub fn heads(&self) -> String {
        self.line(&self.0.iter().map(|column| column.head()).collect::<Vec<_>>())
    }

    /// A row, as a line of the terminal. A cell wider than its column moves those after it.
    pub fn line(&self, cells: &[impl AsRef<str>]) -> String {
        debug_assert_eq!(cells.len(), self.0.len(), "a cell for each column");
        let mut line = String::new();
        for (column, cell) in self.0.iter().zip(cells) {
            let (gap, cell) = (if line.is_empty() { "" } else { "  " }, cell.as_ref());
            // Writing into a string does not fail.
            let _ = match *column {
                Column::Text(head, width) => write!(line, "{gap}{cell:<0$}", width.max(head.chars().count())),
                Column::Number(head, width) => write!(line, "{gap}{cell:>0$}", width.max(head.chars().count())),
            };
        }
        line.trim_end().to_owned()
    }

    /// The whole table in Markdown.
    pub fn markdown<R: AsRef<[String]>>(&self, rows: impl IntoIterator<Item = R>) -> String {
        let mut text = String::new();
        let mut line = |cells: &mut dyn Iterator<Item = &str>| {
            text.push('|');
            cells.for_each(|cell| text.extend([" ", cell, if cell.is_empty() { "|" } else { " |" }]));
            text.push('\n');
        };
        line(&mut self.0.iter().map(|column| column.head()));
        for row in rows {
            debug_assert_eq!(row.as_ref().len(), self.0.len(), "a cell for each column");
            let cells: Vec<String> = row.as_ref().iter().map(|cell| cell.replace('|', "\\|")).collect();
            line(&mut cells.iter().map(String::as_str));
        }
        let marks: String =
            self.0.iter().map(|column| if matches!(column, Column::Text(..)) { "---|" } else { "---:|" }).collect();
        let heads = text.find('\n').map_or(0, |end| end + 1);
        text.insert_str(heads, &format!("|{marks}\n"));
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: Table<'_> = Table(&[Column::Text("", 5), Column::Number("ms", 6), Column::Text("verdict", 0)]);

    #[test]
    fn numbers_end_and_texts_begin_under_one_another() {
        assert_eq!(TABLE.heads(), "           ms  verdict");
        assert_eq!(TABLE.line(&["all", "1.50", ""]), "all      1.50");
        assert_eq!(TABLE.line(&["beyond", "12.25", "worse"]), "beyond   12.25  worse");
    }

    #[test]
    fn markdown_aligns_numbers_and_keeps_bars_inside_cells() {
        let rows = [["a|b", "1", "–"], ["c", "2", ""]].map(|row| row.map(str::to_owned));
        assert_eq!(TABLE.markdown(rows), "| | ms | verdict |\n|---|---:|---|\n| a\\|b | 1 | – |\n| c | 2 | |\n");
    }
}
