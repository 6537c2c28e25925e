/* Lanes one by one by CVODE(S), each to its event. The file that includes this one defines UNKNOWNS, PARAMETERS, DIRECTION,
   start, rates, jacobian, event, and along the number of the derivative start_along, rates_along, event_along. */

#include <math.h>
#include <stddef.h>

#include <cvodes/cvodes.h>
#include <nvector/nvector_serial.h>
#include <sunlinsol/sunlinsol_dense.h>
#include <sunmatrix/sunmatrix_dense.h>

static const double *numbers;

static int of_rates(double t, N_Vector s, N_Vector out, void *data)
{
  rates(t, NV_DATA_S(s), numbers, NV_DATA_S(out));
  return 0;
}

static int of_jacobian(double t, N_Vector s, N_Vector rate, SUNMatrix out, void *data, N_Vector a, N_Vector b, N_Vector c)
{
  jacobian(t, NV_DATA_S(s), numbers, SM_DATA_D(out));
  return 0;
}

static int of_event(double t, N_Vector s, double *out, void *data)
{
  out[0] = event(t, NV_DATA_S(s), numbers);
  return 0;
}

static int of_along(int count, double t, N_Vector s, N_Vector rate, int i, N_Vector by, N_Vector out, void *data,
                    N_Vector a, N_Vector b)
{
  rates_along(t, NV_DATA_S(s), numbers, NV_DATA_S(by), NV_DATA_S(out));
  return 0;
}

/* Times of events, NaN where there is none, and with `order` 1 their derivatives. Returns the steps of all lanes. */
long solve_lanes(long lanes, const double *given, double rtol, double atol, double t1, int order, double *t, double *by)
{
  SUNContext context;
  int direction = DIRECTION;
  long steps = 0;
  SUNContext_Create(NULL, &context);
  N_Vector s = N_VNew_Serial(UNKNOWNS, context), *along = N_VCloneVectorArray(1, s);
  SUNMatrix matrix = SUNDenseMatrix(UNKNOWNS, UNKNOWNS, context);
  SUNLinearSolver solver = SUNLinSol_Dense(s, matrix, context);
  void *cvode = CVodeCreate(CV_BDF, context);
  numbers = given;
  start(numbers, NV_DATA_S(s));
  CVodeInit(cvode, of_rates, 0.0, s);
  CVodeSStolerances(cvode, rtol, atol);
  CVodeSetLinearSolver(cvode, solver, matrix);
  CVodeSetJacFn(cvode, of_jacobian);
  CVodeRootInit(cvode, 1, of_event);
  CVodeSetRootDirection(cvode, &direction);
  CVodeSetMaxNumSteps(cvode, 1000000);
  CVodeSetStopTime(cvode, t1);
  CVodeSetErrFile(cvode, NULL);
  for (long lane = 0; lane < lanes; lane++) {
    double at, rate[UNKNOWNS];
    long more = 0;
    numbers = given + PARAMETERS * lane;
    start(numbers, NV_DATA_S(s));
    start_along(numbers, NV_DATA_S(along[0]));
    CVodeReInit(cvode, 0.0, s);
    if (order && lane == 0) {
      CVodeSensInit1(cvode, 1, CV_STAGGERED, of_along, along);
      CVodeSensEEtolerances(cvode);
      CVodeSetSensErrCon(cvode, 1);
    } else if (order)
      CVodeSensReInit(cvode, CV_STAGGERED, along);
    if (order) {
      double scale = fabs(numbers[WRT]);
      CVodeSetSensParams(cvode, NULL, &scale, NULL);
    }
    int found = CVode(cvode, t1, s, &at, CV_NORMAL);
    t[lane] = found == CV_ROOT_RETURN ? at : NAN;
    if (order && found == CV_ROOT_RETURN) {
      CVodeGetSens(cvode, &at, along);
      rates(at, NV_DATA_S(s), numbers, rate);
      by[lane] = -event_along(at, NV_DATA_S(s), numbers, NV_DATA_S(along[0]), 1.0)
                 / event_along(at, NV_DATA_S(s), numbers, rate, 0.0);
    } else if (order)
      by[lane] = NAN;
    CVodeGetNumSteps(cvode, &more);
    steps += more;
    CVodeSetStopTime(cvode, t1);
  }
  CVodeFree(&cvode);
  SUNLinSolFree(solver);
  SUNMatDestroy(matrix);
  N_VDestroyVectorArray(along, 1);
  N_VDestroy(s);
  SUNContext_Free(&context);
  return steps;
}
