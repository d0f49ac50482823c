// Pinocchio's kinematics in a loop, through its C++ interface: what a user of it would write. Compiled with
// -O3 -DNDEBUG. chain_new takes an arm by DH numbers; the other functions give processor seconds for so many
// rounds over the joint vectors, and leave the results of the last one.
#include <time.h>

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/multibody.hpp>

namespace {

namespace pin = pinocchio;

double now_s()
{
    struct timespec t;
    (void)clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

pin::SE3 turn_and_shift(char axis, double angle, double shift)
{
    const Eigen::Vector3d along = axis == 'z' ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX();
    return {Eigen::AngleAxisd(angle, along).toRotationMatrix(), shift * along};
}

struct Chain {
    pin::Model model;
    std::unique_ptr<pin::Data> data;
    pin::FrameIndex tool = 0;
    pin::Data::Matrix6x J, regressor;
};

}  // namespace

extern "C" {

// An arm of n revolute joints: rows of phi, alpha, a, d; base and tool are shifted only.
void *chain_new(int n, const double *dh, const double *base_m, const double *tool_m)
{
    auto *chain = new Chain;
    pin::SE3 at(Eigen::Matrix3d::Identity(), Eigen::Map<const Eigen::Vector3d>(base_m));
    pin::JointIndex parent = 0;
    for (int j = 0; j < n; j++) {
        parent = chain->model.addJoint(parent, pin::JointModelRZ(), at, "j" + std::to_string(j));
        chain->model.appendBodyToJoint(parent, pin::Inertia::Identity(), pin::SE3::Identity());
        const double *row = dh + 4 * j;
        at = turn_and_shift('z', row[0], row[3]) * turn_and_shift('x', row[1], row[2]);
    }
    at = at * pin::SE3(Eigen::Matrix3d::Identity(), Eigen::Map<const Eigen::Vector3d>(tool_m));
    chain->tool = chain->model.addFrame(pin::Frame("tool", parent, 0, at, pin::OP_FRAME));
    chain->data = std::make_unique<pin::Data>(chain->model);
    chain->J = pin::Data::Matrix6x::Zero(6, chain->model.nv);
    chain->regressor = pin::Data::Matrix6x::Zero(6, 6 * n);
    return chain;
}

void chain_free(void *made) { delete static_cast<Chain *>(made); }

// Placements of all joints and Jacobian of the tool by the joints. T: 3 x 4, J: n x 6, of the last vector.
double chain_kinematics(void *made, int count, const double *q, int rounds, double *T, double *J)
{
    auto *c = static_cast<Chain *>(made);
    const int n = c->model.nq;
    const double begun = now_s();
    for (int k = 0; k < rounds; k++) {
        for (int i = 0; i < count; i++) {
            pin::computeJointJacobians(c->model, *c->data, Eigen::Map<const Eigen::VectorXd>(q + i * n, n));
            pin::updateFramePlacement(c->model, *c->data, c->tool);
            pin::getFrameJacobian(c->model, *c->data, c->tool, pin::LOCAL_WORLD_ALIGNED, c->J);
        }
    }
    const double took = now_s() - begun;
    Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> pose(T);
    pose << c->data->oMf[c->tool].rotation(), c->data->oMf[c->tool].translation();
    Eigen::Map<Eigen::Matrix<double, 6, Eigen::Dynamic>>(J, 6, n) = c->J;
    return took;
}

// The same, and derivatives of the tool by a displacement of every joint: what Pinocchio has for errors of
// the geometry. R: 6 n x 6, of the last vector.
double chain_regressor(void *made, int count, const double *q, int rounds, double *R)
{
    auto *c = static_cast<Chain *>(made);
    const int n = c->model.nq;
    const double begun = now_s();
    for (int k = 0; k < rounds; k++) {
        for (int i = 0; i < count; i++) {
            pin::computeJointJacobians(c->model, *c->data, Eigen::Map<const Eigen::VectorXd>(q + i * n, n));
            pin::updateFramePlacement(c->model, *c->data, c->tool);
            pin::getFrameJacobian(c->model, *c->data, c->tool, pin::LOCAL_WORLD_ALIGNED, c->J);
            pin::computeFrameKinematicRegressor(c->model, *c->data, c->tool, pin::LOCAL_WORLD_ALIGNED,
                                                c->regressor);
        }
    }
    const double took = now_s() - begun;
    Eigen::Map<Eigen::Matrix<double, 6, Eigen::Dynamic>>(R, 6, 6 * n) = c->regressor;
    return took;
}

}  // extern "C"
