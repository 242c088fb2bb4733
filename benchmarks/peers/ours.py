"""pamid's own training: a pass, a whole iteration, memory, and the machine's matrix product in the
same process."""

from measuring import Stamps, cpu_seconds, dgemm_rate, peak_mb, record, tell

from pamid.networks.elman import Elman
from pamid.networks.network_training import train
from pamid.networks.training_problem import TrainingOptions

STEPS = 20


def main() -> None:
    u, target, weights = record()
    network = Elman()
    jte = network.normal_equations(weights, u, target)[2]
    stamps = Stamps()
    train(network, u, target, options=TrainingOptions(iterations=STEPS, progress=stamps))
    one_pass = cpu_seconds(lambda: network.normal_equations(weights, u, target), 7)
    peak = peak_mb()  # before the matrices of the next line
    tell(jte, **stamps.step, pass_s=one_pass, peak_mb=peak, dgemm_gf_s=dgemm_rate(7) * 1e-9)


if __name__ == "__main__":
    main()
