//! The `catheter` command seen from outside: what other programs rely on, what it refuses, what it leaves behind.

#[cfg(target_os = "linux")]
mod board;
#[cfg(target_os = "linux")]
mod board_operate;
mod bring_up;
mod c_source;
mod calibrate;
mod check;
mod contract;
mod control;
mod demo;
mod discover;
mod evaluate;
mod files;
mod fit;
mod help;
mod hostile;
mod import_network;
mod lab_effects;
mod manners;
mod operate;
mod pages;
mod refusals;
mod rig;
mod streams;
mod support;
