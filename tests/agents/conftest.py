"""Networks in these tests are tiny: threads would only get in each other's way."""

import pytest


@pytest.fixture(autouse=True)
def one_torch_thread():
    import torch

    torch.set_num_threads(1)
