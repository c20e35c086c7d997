//! Figures with their spread over seeds, and Markdown tables of them.

use serde_json::{Value, json};

/// One figure measured with several seeds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spread {
    values: Vec<f64>,
}

impl Spread {
    pub fn push(&mut self, value: f64) {
        self.values.push(value);
    }

    pub fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }

    pub fn least(&self) -> f64 {
        self.values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    pub fn most(&self) -> f64 {
        self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Mean, and least to most where there is more than one value.
    pub fn cell(&self) -> String {
        match self.values.len() {
            0 => "-".to_owned(),
            1 => format!("{:.4}", self.mean()),
            _ => format!("{:.4} ({:.4} to {:.4})", self.mean(), self.least(), self.most()),
        }
    }

    pub fn json(&self) -> Value {
        json!({ "mean": self.mean(), "min": self.least(), "max": self.most(), "seeds": self.values.len() })
    }
}

/// A Markdown table.
pub fn markdown(header: &[&str], rows: &[Vec<String>]) -> String {
    let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | "));
    let mut text = line(header.to_vec());
    text += &line(header.iter().map(|_| "---").collect());
    for row in rows {
        text += &line(row.iter().map(String::as_str).collect());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_shows_mean_and_extremes() {
        let mut spread = Spread::default();
        assert_eq!(spread.cell(), "-");
        spread.push(0.25);
        assert_eq!(spread.cell(), "0.2500");
        spread.push(0.75);
        assert_eq!(spread.cell(), "0.5000 (0.2500 to 0.7500)");
        assert_eq!(spread.json()["max"], 0.75);
    }

    #[test]
    fn a_table_has_a_rule_below_its_header() {
        assert_eq!(markdown(&["a", "b"], &[vec!["1".into(), "2".into()]]), "| a | b |\n| --- | --- |\n| 1 | 2 |\n");
    }
}
