//! One self-contained HTML document: style and script inside, no external resource, readable in light, dark, on paper and without the script,
//! which only adds zooming, reading off values, hiding lines and downloads.

use std::fmt::Write;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};

use super::data::{self, Plot};
use super::svg::Svg;
use super::text::escape;

/// A page under construction.
pub struct Page {
    title: String,
    body: String,
    contents: Vec<(String, String)>,
    figures: usize,
    open_section: bool,
    /// Figures whose plots belong together, while their row is open.
    group: Vec<(String, Vec<Plot>)>,
    open_row: bool,
}

/// A cell of a table.
#[derive(Clone, Debug)]
pub enum Cell {
    /// Words, aligned left.
    Text(String),
    /// A figure, aligned right.
    Figure(String),
    /// A verdict: passed or not.
    Verdict(bool),
}

/// How wide a figure stands on a wide screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// The whole column.
    Full,
    /// Two thirds: beside a `Third`.
    TwoThirds,
    /// A third.
    Third,
    /// Half.
    Half,
}

impl Page {
    /// An empty page with its main heading and a line below it.
    #[must_use]
    pub fn new(title: &str, lead: &str) -> Self {
        let body = format!("<header><h1>{}</h1><p class=\"lead\">{}</p></header>", escape(title), escape(lead));
        Self { title: title.to_owned(), body, contents: Vec::new(), figures: 0, open_section: false, group: Vec::new(), open_row: false }
    }

    /// Starts a section; its heading appears in the contents.
    pub fn section(&mut self, heading: &str) {
        self.close_section();
        let id = format!("s{}", self.contents.len() + 1);
        let _ = write!(self.body, "<section aria-labelledby=\"{id}\"><h2 id=\"{id}\">{}</h2>", escape(heading));
        self.contents.push((id, heading.to_owned()));
        self.open_section = true;
    }

    fn close_section(&mut self) {
        if self.open_section {
            self.body.push_str("</section>");
            self.open_section = false;
        }
    }

    /// A heading within a section.
    pub fn heading(&mut self, text: &str) {
        let _ = write!(self.body, "<h3>{}</h3>", escape(text));
    }

    /// A paragraph; `**words**` stand out.
    pub fn paragraph(&mut self, text: &str) {
        let _ = write!(self.body, "<p>{}</p>", emphasised(text));
    }

    /// Lines of commands or figures, as they are.
    pub fn code(&mut self, text: &str) {
        let _ = write!(self.body, "<pre><code>{}</code></pre>", escape(text));
    }

    /// A help to read what follows or precedes, set apart.
    pub fn how_to_read(&mut self, text: &str) {
        let _ = write!(self.body, "<aside class=\"read\"><strong>How to read this.</strong> {}</aside>", emphasised(text));
    }

    /// Large figures side by side: value, what it is, and whether it is good where that was checked.
    pub fn tiles(&mut self, tiles: &[(String, String, Option<bool>)]) {
        self.body.push_str("<div class=\"tiles\">");
        for (value, what, good) in tiles {
            let class = match good {
                Some(true) => "tile good",
                Some(false) => "tile bad",
                None => "tile",
            };
            let _ = write!(self.body, "<div class=\"{class}\"><b>{}</b><span>{}</span></div>", escape(value), emphasised(what));
        }
        self.body.push_str("</div>");
    }

    /// Starts a row of figures.
    pub fn begin_row(&mut self) {
        self.open_row = true;
        self.body.push_str("<div class=\"row\">");
    }

    /// Ends a row of figures.
    pub fn end_row(&mut self) {
        self.body.push_str("</div>");
        self.open_row = false;
        self.write_group();
    }

    /// The numbers behind the figures so far, for the script.
    fn write_group(&mut self) {
        if let Some(numbers) = data::group(&std::mem::take(&mut self.group)) {
            let _ = write!(self.body, "<script type=\"application/json\">{numbers}</script>");
        }
    }

    /// A figure with its caption (`**words**` stand out).
    pub fn figure(&mut self, mut svg: Svg, width: Width, caption: &str) {
        self.figures += 1;
        let class = match width {
            Width::Full => "full",
            Width::TwoThirds => "two-thirds",
            Width::Third => "third",
            Width::Half => "half",
        };
        let id = format!("f{}", self.figures);
        self.group.push((id.clone(), svg.take_plots()));
        let drawing = svg.finish(&id);
        let caption = if caption.is_empty() { String::new() } else { format!("<figcaption>{}</figcaption>", emphasised(caption)) };
        let _ = write!(self.body, "<figure class=\"{class}\">{drawing}{caption}</figure>");
        if !self.open_row {
            self.write_group();
        }
    }

    /// A table with a caption; the first column names the row.
    pub fn table(&mut self, caption: &str, header: &[&str], rows: &[Vec<Cell>], marked: Option<usize>) {
        let _ = write!(self.body, "<div class=\"scroll\"><table><caption>{}</caption><thead><tr>", emphasised(caption));
        let right = |column: usize| rows.first().and_then(|row| row.get(column)).is_some_and(|cell| matches!(cell, Cell::Figure(_)));
        for (column, name) in header.iter().enumerate() {
            let class = if right(column) { " class=\"figure\"" } else { "" };
            let _ = write!(self.body, "<th scope=\"col\"{class}>{}</th>", escape(name));
        }
        self.body.push_str("</tr></thead><tbody>");
        for (index, row) in rows.iter().enumerate() {
            self.body.push_str(if marked == Some(index) { "<tr class=\"chosen\">" } else { "<tr>" });
            for (column, cell) in row.iter().enumerate() {
                let (open, close) = if column == 0 { ("<th scope=\"row\"", "</th>") } else { ("<td", "</td>") };
                let _ = match cell {
                    Cell::Text(text) => write!(self.body, "{open}>{}{close}", escape(text)),
                    Cell::Figure(text) => write!(self.body, "{open} class=\"figure\">{}{close}", escape(text)),
                    Cell::Verdict(true) => write!(self.body, "{open} class=\"passed\">\u{2713} passed{close}"),
                    Cell::Verdict(false) => write!(self.body, "{open} class=\"failed\">\u{2717} failed{close}"),
                };
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</tbody></table></div>");
    }

    /// The whole document.
    #[must_use]
    pub fn finish(mut self, footer: &str) -> String {
        self.close_section();
        let provenance = output::provenance::line();
        let links: Vec<String> =
            self.contents.iter().map(|(id, heading)| format!("<li><a href=\"#{id}\">{}</a></li>", escape(heading))).collect();
        let contents =
            if links.len() > 1 { format!("<nav aria-label=\"Contents\"><ol>{}</ol></nav>", links.concat()) } else { String::new() };
        // The contents stand between the header and the first section.
        let body = match self.body.split_once("</header>") {
            Some((header, rest)) => format!("{header}</header>{contents}<main>{rest}</main>"),
            None => self.body,
        };
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <meta name=\"color-scheme\" content=\"light dark\">\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; script-src 'sha256-{}'\">\
             <title>{}</title><style>{STYLE}</style></head><body>{body}<footer>{}{}</footer><script>{SCRIPT}</script></body></html>\n",
            STANDARD.encode(Sha256::digest(SCRIPT)),
            escape(&self.title),
            emphasised(footer),
            if provenance.is_empty() { String::new() } else { format!("<p class=\"provenance\">{}</p>", escape(&provenance)) }
        )
    }
}

/// Escaped text in which `**words**` stand out and what is between backticks is code.
fn emphasised(text: &str) -> String {
    let parts = between(&escape(text), "`", "code");
    between(&parts, "**", "strong")
}

/// Puts what stands between two marks into an element; a mark without a second one ends with the text.
fn between(text: &str, mark: &str, element: &str) -> String {
    let mut html = String::new();
    for (index, part) in text.split(mark).enumerate() {
        match (index, index % 2) {
            (0, _) => {}
            (_, 1) => html.extend(["<", element, ">"]),
            _ => html.extend(["</", element, ">"]),
        }
        html.push_str(part);
    }
    if text.matches(mark).count() % 2 == 1 {
        html.extend(["</", element, ">"]);
    }
    html
}

const STYLE: &str = include_str!("style.css");

/// The only script that the page's policy allows, by its hash.
const SCRIPT: &str = include_str!("script.js");
