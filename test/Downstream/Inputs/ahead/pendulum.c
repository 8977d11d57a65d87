/* The gradient of the compiled function, against central differences. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>

typedef struct {
  double *allocated, *aligned;
  int64_t offset;
} Number;
typedef struct {
  double *allocated, *aligned;
  int64_t offset, size, stride;
} Numbers;

void _mlir_ciface_swing(Numbers *state, Number *angle);
/* As func.func is lowered: each memref by its parts. */
void swing_grad(double *, double *, int64_t, int64_t, int64_t, double *,
                double *, int64_t, double *, double *, int64_t, int64_t,
                int64_t, double *, double *, int64_t);

static double swing(const double *from) {
  double state[2] = {from[0], from[1]}, angle = 0;
  Numbers in = {state, state, 0, 2, 1};
  Number out = {&angle, &angle, 0};
  _mlir_ciface_swing(&in, &out);
  return angle;
}

int main(void) {
  double state[2] = {1.0, 0.5}, angle = 0, gradient[2] = {0, 0}, seed = 1;
  swing_grad(state, state, 0, 2, 1, &angle, &angle, 0, gradient, gradient, 0, 2,
             1, &seed, &seed, 0);
  for (int i = 0; i < 2; ++i) {
    double plus[2] = {state[0], state[1]}, minus[2] = {state[0], state[1]};
    plus[i] += 1e-6;
    minus[i] -= 1e-6;
    double difference = (swing(plus) - swing(minus)) / 2e-6;
    printf("pendulum: %.6f, by differences %.6f\n", gradient[i], difference);
    if (!(fabs(gradient[i] - difference) < 1e-7))
      return 1;
  }
  return 0;
}
