//! Files as other programs leave them: separators, titles, names with units in parentheses, several recordings and inputs.

use super::*;

fn foreign(text: &str, columns: &str) -> Recording {
    parse(Path::new("run.dat"), text.as_bytes(), &ColumnMap::parse(columns).expect("a map")).expect("read")
}

#[test]
fn spaces_tabs_and_semicolons_separate_columns_below_titles() {
    let columns = "time=time(sec),input=cmd:1,output=pressure:N";
    let spaces = "# a title\n# another\nA rig, of 2020\n\ntime(sec)  cmd pressure\n0.000 0.5  1.25\n 0.010 0.6 1.50\n0.020 0.7 1.75\n";
    let wanted = foreign(spaces, columns);
    assert_eq!((wanted.input.clone(), wanted.output.clone()), (vec![0.5, 0.6, 0.7], vec![1.25, 1.5, 1.75]));
    let notes: Vec<&str> = wanted.notes.iter().filter(|note| note.subject == Subject::Layout).map(|note| note.text.as_str()).collect();
    assert_eq!(notes, ["The columns are separated by spaces.", "1 title line(s) above the header were passed over."]);
    let semicolons = "time(sec);cmd;pressure\n0,000;0,5;1,25\n0,010;0,6;1,50\n0,020;0,7;1,75\n";
    let tabs = "time(sec)\tcmd\tpressure\n0.000\t0.5\t1.25\n0.010\t0.6\t1.50\n0.020\t0.7\t1.75\n";
    for text in [semicolons, tabs] {
        let other = foreign(text, columns);
        assert_eq!((&other.time_s, &other.input, &other.output), (&wanted.time_s, &wanted.input, &wanted.output));
    }
    let error = parse(
        Path::new("run.dat"),
        b"# t\nt_s a_V b_mm\n0 1 2\n1 oops 3\n",
        &ColumnMap::parse("time=t_s,input=a_V,output=b_mm").expect("a map"),
    );
    assert!(error.expect_err("no number").to_string().starts_with("run.dat:4: column `a_V` holds `oops`"));
}

#[test]
fn units_in_parentheses_belong_to_the_name_or_stand_for_themselves() {
    let text = "Time (ms),Pressure (bar),Laser [um]\n0,1,2\n10,3,4\n20,5,6\n";
    for columns in [
        "time=Time (ms),input=Pressure (bar),output=Laser [um]",
        "time=Time:ms,input=Pressure:bar,output=Laser [um]",
        "time=Time (ms):ms,input=Pressure (bar):bar,output=Laser [um]",
    ] {
        let recording = foreign(text, columns);
        assert_eq!(recording.time_s, [0.0, 0.01, 0.02]);
        assert_eq!((recording.input_signal.column().as_str(), recording.output_signal.column().as_str()), ("Pressure_bar", "Laser_um"));
    }
}

#[test]
fn several_inputs_and_carried_columns_have_their_roles() {
    let text = "t_s,a_bar,b_bar,y_mm,pm_bar,temp_degC,clock_min\n0,1,2,3,4,20,1\n1,2,4,6,8,21,2\n2,3,6,9,12,22,3\n";
    let columns = "time=t_s,input=a_bar,input2=b_bar,output=y_mm,measured=pm_bar,temperature=temp_degC,session=clock_min";
    let recording = foreign(text, columns);
    assert_eq!(recording.inputs(), [&[1.0, 2.0, 3.0], &[2.0, 4.0, 6.0]]);
    assert_eq!(recording.more_inputs[0].signal, Signal { quantity: "b".into(), unit: "bar".into() });
    let extra: Vec<(&str, f64)> = recording.extra.iter().map(|column| (column.name.as_str(), column.values[2])).collect();
    assert_eq!(extra, [("pressure_measured_bar", 12.0), ("temperature_c", 22.0), ("session_time_s", 180.0)]);
}

#[test]
fn a_column_sets_recordings_apart_and_another_groups_them() {
    let mut text = "episode,load,p,q\n".to_owned();
    for row in 0..40_u32 {
        text += &format!("{},{},{},{}\n", 7 + row / 10, if row < 20 { "light" } else { "heavy" }, row % 10, row);
    }
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("arm.csv");
    std::fs::write(&path, &text).expect("write");
    let options = ReadOptions {
        columns: Some("input=p:bar,output=q:rad,recording=episode,group=load".into()),
        rate_hz: Some(100.0),
        ..ReadOptions::default()
    };
    let recordings = load_with(std::slice::from_ref(&path), &options).expect("read");
    let names: Vec<String> =
        recordings.iter().map(|recording| recording.path.file_name().expect("a name").to_string_lossy().into_owned()).collect();
    assert_eq!(names, ["arm.csv#7", "arm.csv#8", "arm.csv#9", "arm.csv#10"]);
    let groups: Vec<&str> = recordings.iter().map(|recording| recording.group.as_str()).collect();
    assert_eq!(groups, ["light", "light", "heavy", "heavy"]);
    assert!(recordings.iter().all(|recording| recording.file() == path && recording.len() == 10 && recording.time_s[9] == 0.09));
    let without = ReadOptions { rate_hz: None, ..options };
    assert!(load_with(&[path], &without).expect_err("no clock").to_string().contains("--rate-hz"));
}

#[test]
fn names_show_groups_of_days_loads_and_amplitudes() {
    let named = |names: &[&str]| {
        let recording =
            |name: &&str| own(&format!("{HEADER}0,1,2\n1,2,3\n")).map(|recording| Recording { path: PathBuf::from(name), ..recording });
        let mut recordings: Vec<Recording> = names.iter().map(|name| recording(name).expect("read")).collect();
        groups::assign(&mut recordings);
        recordings.into_iter().map(|recording| recording.group).collect::<Vec<_>>()
    };
    assert_eq!(named(&["r_30lb_1in.csv", "r_30lb_2in.csv", "s_30lb_1in.csv"]), ["1in", "2in", "1in"]);
    assert_eq!(
        named(&["a_2019-08-07_2kg.csv", "b_2019-08-07_4kg.csv", "c_2019-08-08_2kg.csv"]),
        ["2019-08-07", "2019-08-07", "2019-08-08"]
    );
    assert_eq!(named(&["day1/a.csv", "day1/b.csv", "day2/a.csv"]), ["day1", "day1", "day2"]);
    // Our own data sets: nothing in them is a day, a load or an amplitude.
    assert_eq!(named(&["train/a_01_f0.3_tau0.04.csv", "train/a_02_f0.4_tau0.04.csv", "train/b_01.csv"]), ["", "", ""]);
}

#[test]
fn what_samples_show_is_noted() {
    let mut text = HEADER.to_owned();
    for row in 0..2000_u32 {
        let time_s = f64::from(row) * 0.01;
        let pressure = (30.0 * (time_s * 1.3).sin()).clamp(-25.0, 25.0);
        text += &format!("{time_s},{pressure},{}\n", (pressure / 2.5 + (time_s * 0.77).cos()).round() * 0.5);
    }
    let recording = own(&text).expect("read");
    let subjects: Vec<Subject> = recording.notes.iter().map(|note| note.subject).collect();
    for subject in [Subject::Clipped, Subject::Unit, Subject::Quantised] {
        assert!(subjects.contains(&subject), "{subject:?} is not among {:?}", recording.notes);
    }
    assert_eq!(condition::resolution(&recording.output), Some(0.5));
    let line = recording.notes.iter().find(|note| note.subject == Subject::Clipped).and_then(|note| note.line).expect("a line");
    let at = |line: u64| text.lines().nth(line as usize - 1).expect("a row").split(',').nth(1).expect("a cell").to_owned();
    assert!(["25", "-25"].contains(&at(line).as_str()), "line {line} holds {}", at(line));
}
