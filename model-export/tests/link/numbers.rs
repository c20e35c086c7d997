//! Settings, faults, blockers and notices: their numbers, names, units and words.

use model_export::link::fault::{AdaptationCondition, Blocker, Fault, Notice, explain};
use model_export::link::settings::{INFO, SettingError, SettingValue, Settings, by_name};

#[test]
fn settings_have_unique_numbers_names_that_end_in_their_unit_and_defaults_within_bounds() {
    let mut settings = Settings::default();
    for (index, info) in INFO.iter().enumerate() {
        for other in &INFO[..index] {
            assert!(other.number < info.number && other.name != info.name, "{} {}", other.name, info.name);
        }
        assert_eq!(by_name(info.name), Some(info));
        assert_eq!(settings.get(info.number), Some(info.default), "{}", info.name);
        for value in [info.default, info.minimum, info.maximum] {
            assert_eq!(settings.set(info.number, value), Ok(()), "{} {value:?}", info.name);
        }
        settings.set(info.number, info.default).unwrap();
        let unit = info.unit.replace("1/", "per_").replace('/', "_per_").to_lowercase();
        assert!(unit.is_empty() || info.name.ends_with(&format!("_{unit}")), "{} in {}", info.name, info.unit);
        let wrong_type = if info.default == SettingValue::Flag(true) { SettingValue::Integer(1) } else { SettingValue::Flag(true) };
        if !matches!(info.default, SettingValue::Flag(_)) {
            assert_eq!(settings.set(info.number, wrong_type), Err(SettingError::WrongType), "{}", info.name);
        }
        if let (SettingValue::Float(low), SettingValue::Float(high)) = (info.minimum, info.maximum) {
            for value in [low.next_down(), high.next_up(), f32::NAN, f32::INFINITY] {
                assert_eq!(settings.set(info.number, SettingValue::Float(value)), Err(SettingError::OutOfBounds), "{}", info.name);
            }
        }
    }
    assert_eq!(settings, Settings::default());
    assert_eq!(settings.set(60_000, SettingValue::Flag(true)), Err(SettingError::Unknown));
}

#[test]
fn differences_name_both_values() {
    let changed = Settings { ceiling_bar: 2.0, laser_required: false, ..Settings::default() };
    let differences: std::vec::Vec<_> = changed.differences(&Settings::default()).collect();
    assert_eq!(
        differences,
        [(1, SettingValue::Float(2.0), SettingValue::Float(3.0)), (17, SettingValue::Flag(false), SettingValue::Flag(true)),]
    );
}

#[test]
fn everything_with_a_number_is_explained() {
    assert_eq!(explain("E017").unwrap().name, "laser-stuck");
    assert_eq!(explain("e17"), explain("E017"));
    assert_eq!(explain("B03").unwrap().name, "emergency-stop-pressed");
    assert_eq!(explain("N2").unwrap().name, "floor");
    assert_eq!(explain("C05").unwrap().name, "loop-margin");
    for nonsense in ["", "E", "17", "E999", "E000", "X01", "E-1", "Ä1"] {
        assert_eq!(explain(nonsense), None, "{nonsense}");
    }
    let all = Fault::ALL.iter().map(|fault| fault.explanation());
    let all = all.chain(AdaptationCondition::ALL.iter().map(|condition| condition.explanation()));
    let all = all.chain(Blocker::ALL.iter().map(|blocker| blocker.explanation()));
    for explanation in all.chain(Notice::ALL.iter().map(|notice| notice.explanation())) {
        assert!(explanation.meaning.ends_with('.') && explanation.remedy.ends_with('.'), "{explanation:?}");
        assert!(explanation.name.chars().all(|character| character.is_ascii_lowercase() || character == '-'), "{explanation:?}");
    }
}

/// Every setting that a text names exists.
#[test]
fn explanations_name_settings_that_exist() {
    let mut named = 0;
    for fault in Fault::ALL {
        let remedy = fault.explanation().remedy;
        for word in remedy.split([' ', ',', ';', '.']).filter(|word| word.contains('_')) {
            assert!(INFO.iter().any(|info| info.name.ends_with(&format!(".{word}"))), "{word} in {remedy}");
            named += 1;
        }
    }
    assert!(named >= 8);
}
