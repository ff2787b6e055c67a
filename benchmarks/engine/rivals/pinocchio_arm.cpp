// Loops over Pinocchio's ABA, header only. DOF joints that turn about coordinate axes, on a fixed base, each a row of 23 numbers: axis (0 to 2),
// placement in the parent (rotation by rows, translation), mass, centre of mass, inertia about it (xx, xy, yy, xz, yz, zz).
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>

using Vector = Eigen::Matrix<double, DOF, 1>;
using State = Eigen::Matrix<double, 2 * DOF, 1>;
namespace pin = pinocchio;

// Of all its joints these three: the default collection takes a minute to compile.
template <typename S, int O>
struct Turning {
    using Scalar = S;
    enum { Options = O };
    template <int axis>
    using Joint = pin::JointModelRevoluteTpl<S, O, axis>;
    using JointModelVariant = boost::variant<Joint<0>, Joint<1>, Joint<2>, boost::recursive_wrapper<pin::JointModelMimicTpl<S, O, Turning>>>;
    using JointDataVariant = boost::variant<pin::JointDataRevoluteTpl<S, O, 0>, pin::JointDataRevoluteTpl<S, O, 1>, pin::JointDataRevoluteTpl<S, O, 2>,
                                            boost::recursive_wrapper<pin::JointDataMimicTpl<S, O, Turning>>>;
};
using Model = pin::ModelTpl<double, 0, Turning>;
using Data = pin::DataTpl<double, 0, Turning>;

static Model::JointModel about(int axis) {
    if (axis == 0) return Turning<double, 0>::Joint<0>();
    if (axis == 1) return Turning<double, 0>::Joint<1>();
    return Turning<double, 0>::Joint<2>();
}

static Model built(const double* joints, const double* gravity) {
    Model model;
    model.gravity.linear() = Eigen::Map<const Eigen::Vector3d>(gravity);
    for (int i = 0; i < DOF; i++) {
        const double* row = joints + 23 * i;
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> turn(row + 1);
        const pin::SE3 place(turn, Eigen::Map<const Eigen::Vector3d>(row + 10));
        const Eigen::Map<const Eigen::Vector3d> centre(row + 14);
        const Eigen::Map<const Eigen::Matrix<double, 6, 1>> inertia(row + 17);
        const auto index = model.addJoint(i, about(int(row[0])), place, "joint" + std::to_string(i));
        model.appendBodyToJoint(index, pin::Inertia(row[13], centre, pin::Symmetric3(inertia)), pin::SE3::Identity());
    }
    return model;
}

// move: 0 semi-implicit Euler, 1 RK4, 2 RK4 under computed torque; targets: q, q', q'' of every step; gains: of q and q'.
extern "C" void run(const double* joints, const double* gravity, int move, double h, long steps, const double* targets, const double* gains,
                    long runs, double* states, const double* torques, int threads) {
    const Model model = built(joints, gravity);
#pragma omp parallel num_threads(threads)
    {
        Data data(model);
        const auto rate = [&](const State& x, const Vector& u) {
            State found;
            found << x.tail<DOF>(), pin::aba(model, data, x.head<DOF>(), x.tail<DOF>(), u);
            return found;
        };
#pragma omp for
        for (long k = 0; k < runs; k++) {
            Eigen::Map<State> kept(states + 2 * DOF * k);
            State x = kept;
            Vector u = Eigen::Map<const Vector>(torques + DOF * k);
            for (long i = 0; i < steps; i++) {
                if (move == 0) {
                    x.tail<DOF>() += h * pin::aba(model, data, x.head<DOF>(), x.tail<DOF>(), u);
                    x.head<DOF>() += h * x.tail<DOF>();
                    continue;
                }
                if (move == 2) {
                    const Eigen::Map<const Eigen::Matrix<double, DOF, 3>> target(targets + 3 * DOF * i);
                    const Vector a = target.col(2) + gains[0] * (target.col(0) - x.head<DOF>()) + gains[1] * (target.col(1) - x.tail<DOF>());
                    u = pin::rnea(model, data, x.head<DOF>(), x.tail<DOF>(), a);
                }
                const State a = rate(x, u), b = rate(x + h / 2 * a, u), c = rate(x + h / 2 * b, u), d = rate(x + h * c, u);
                x += h / 6 * (a + 2 * b + 2 * c + d);
            }
            kept = x;
        }
    }
}
