import numpy as np
import pandas as pd

from calls import refused
from epiprior_lab.evaluation import records
from epiprior_lab.evaluation.records import RANKS, PairRecord, Tables, TimingRecord, read_frame, read_table, write_frame
from synthetic_tables import photograph_tables, study_tables, timing_table


def test_tables_are_read_as_they_were_written_and_names_stay_text(tmp_path):
    for name, tables in (("study", study_tables(pairs=2)), ("photographs", photograph_tables())):
        tables.write(tmp_path / name)
        assert {path.stem for path in (tmp_path / name).iterdir()} == set(Tables.kinds)
        again = Tables.read([tmp_path / name])
        for kind in Tables.kinds:
            pd.testing.assert_frame_equal(getattr(again, kind), getattr(tables, kind), rtol=1e-6)
    both = Tables.read([tmp_path / "study", tmp_path / "photographs"])
    assert len(both.runs) == len(study_tables(pairs=2).runs) + len(photograph_tables().runs)
    photograph_tables().write(tmp_path)
    lines = (tmp_path / "pairs.csv").read_text().splitlines()
    assert lines[0].startswith("group,pair_id,scene,features1,features2,labels,points,right_share,difficulty")
    unlabelled = next(line for line in lines if line.startswith("strecha,0005"))
    assert unlabelled.split(",")[5:9] == ["", "control_points", "", ""]
    pairs = Tables.read([tmp_path]).pairs
    assert pairs["pair_id"].iloc[0] == "0000"
    assert pairs.loc[pairs["labels"] == "", "right_share"].isna().all()
    assert Tables.read([tmp_path]).runs["iterations"].dtype == "Int64"


def test_tables_keep_columns_types_and_seven_digits_and_damaged_ones_are_named(tmp_path):
    write_frame(records.to_frame(records.CalibrationRecord, []), tmp_path / "calibration.csv")
    assert len(read_frame(records.CalibrationRecord, tmp_path / "calibration.csv")) == 0
    timings = timing_table(study_tables(pairs=2))
    write_frame(timings, tmp_path / "timings.csv")
    again = read_frame(TimingRecord, tmp_path / "timings.csv")
    pd.testing.assert_frame_equal(again, timings, rtol=1e-6)
    assert again["preprocessed"].dtype == bool
    assert (RANKS[:7], RANKS[-4:], len(RANKS)) == ((1, 2, 3, 4, 5, 6, 8), (5012, 6310, 7943, 10_000), 39)
    columns = records.column_types(Tables.kinds["rankings"])
    assert [name for name in columns if name.startswith("right_")] == [f"right_{rank}" for rank in RANKS]
    path, table = tmp_path / "pairs.csv", study_tables(pairs=1).pairs
    refused(records.TableError, r"pairs\.csv: cannot be read", read_frame, PairRecord, path)
    write_frame(table.drop(columns="difficulty"), path)
    refused(records.TableError, r"pairs\.csv: no column 'difficulty'", read_frame, PairRecord, path)
    refused(records.TableError, "no column 'difficulty'", read_table, path, "group difficulty")
    assert read_table(path, "group scene").shape == (len(table), table.shape[1] - 1)
    write_frame(table.assign(features1="many"), path)
    refused(records.TableError, r"pairs\.csv: cannot be read", read_frame, PairRecord, path)
    write_frame(pd.DataFrame({"a": [np.pi, np.nan], "b": ["x", "y"]}), tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_bytes() == b"a,b\n3.141593,x\n,y\n"
