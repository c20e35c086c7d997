//! Templates: fixed text in C with places for a model's own words.

use model_export::blob::Blob;
use model_export::schema::Model;

use super::name::Name;

/// What every part needs of the model.
pub struct Context<'a> {
    pub name: &'a Name,
    pub blob: &'a Blob<'a>,
}

impl Context<'_> {
    pub fn model(&self) -> &Model<'_> {
        &self.blob.model
    }
}

/// A template with its words replaced; in one pass, so that nothing in a model's texts is taken for a word.
pub fn fill(template: &str, words: &[(&str, &str)]) -> String {
    let value = |word: &str| words.iter().find(|(key, _)| *key == word).map(|(_, value)| *value);
    // Every second part stands between two signs.
    let parts = template.split('@').enumerate();
    parts.map(|(index, part)| if index % 2 == 0 { part } else { value(part).unwrap_or(part) }).collect()
}
