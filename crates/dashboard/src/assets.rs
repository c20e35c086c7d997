//! The page, compiled in.

use axum::extract::Path;
use axum::http::{StatusCode, header};
use axum::response::{Html, IntoResponse, Response};

macro_rules! assets {
    ($($name:literal $kind:literal $file:literal;)*) => {
        /// Name, media type and contents of each.
        const ASSETS: &[(&str, &str, &str)] = &[$(($name, $kind, include_str!(concat!("../page/", $file))),)*];
    };
}

const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

assets! {
    "style.css" "css" "style.css";
    "panels.css" "css" "panels.css";
    "main.js" "js" "main.js";
    "link.js" "js" "link.js";
    "beat.js" "js" "beat.js";
    "history.js" "js" "history.js";
    "charts.js" "js" "charts.js";
    "loop.js" "js" "loop.js";
    "operate.js" "js" "operate.js";
    "excitation.js" "js" "excitation.js";
    "sketch.js" "js" "sketch.js";
    "reference.js" "js" "reference.js";
    "calibrate.js" "js" "calibrate.js";
    "settings.js" "js" "settings.js";
    "learn.js" "js" "learn.js";
    "elements.js" "js" "elements.js";
    "uplot.js" "js" "vendor/uPlot.iife.min.js";
    "uplot.css" "css" "vendor/uPlot.min.css";
}

pub(crate) async fn index() -> Html<&'static str> {
    Html(include_str!("../page/index.html"))
}

pub(crate) async fn asset(Path(name): Path<String>) -> Response {
    match ASSETS.iter().find(|(known, _, _)| *known == name) {
        Some((_, kind, text)) => ([(header::CONTENT_TYPE, if *kind == "js" { SCRIPT } else { STYLE })], *text).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}
