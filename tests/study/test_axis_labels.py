"""The table [labels] names axes, changes no run, and is checked like the rest of the manifest."""

import pytest
from conftest import BASIC

import nfbench
from nfbench import ManifestError
from nfbench.study import read_labels


def test_labels_are_read_by_key_and_change_no_run(manifest):
    swept = BASIC + "[sweep]\nnoise = [0.0, 1.0]\n"
    plain = nfbench.load_study(manifest(swept))
    path = manifest(swept + '[labels]\n"scenario.noise" = "Rauschen [dB]"\nrmse = "Fehler [m]"\n', file="labelled.toml")
    labelled = nfbench.load_study(path)
    assert read_labels(path) == {"noise": "Rauschen [dB]", "rmse": "Fehler [m]"}
    assert [spec.run_id for spec in labelled.specs()] == [spec.run_id for spec in plain.specs()]


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (
            'noize = "Noise"',
            "labels.noize: expected a swept key or one of rmse, median, runtime; did you mean 'noise'?",
        ),
        ('noise = " "', "labels.noise: expected a label of 1 to 80 characters"),
        ("noise = 3", "labels: expected string, got 3"),
    ],
)
def test_wrong_labels_are_errors_with_their_key(manifest, labels, message):
    with pytest.raises(ManifestError) as error:
        nfbench.load_study(manifest(f"{BASIC}[sweep]\nnoise = [0.0, 1.0]\n[labels]\n{labels}\n"))
    assert message in str(error.value)


def test_a_manifest_that_cannot_be_read_has_no_labels(tmp_path):
    assert read_labels(tmp_path / "nothing.toml") == {}
    (tmp_path / "odd.toml").write_text('labels = ["a"]')
    assert read_labels(tmp_path / "odd.toml") == {}
