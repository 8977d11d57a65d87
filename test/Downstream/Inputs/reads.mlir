tai.tree @t : !tai.root<dense<[i: 8], {x: f64, y: f64, x_grad: f64, y_grad: f64}>>
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad

// Its reads stand in the summary, with their indices.
// SUMMARY-DAG: #[[NEXT:.+]] = affine_map<(d0)[s0] -> (d0 + 1)>
// SUMMARY-DAG: #[[OWN:.+]] = affine_map<(d0)[s0] -> (d0)>
//     SUMMARY: tai.kernel @next({{.*}}summary = [#tai.access<read @x, #[[NEXT]]>, #tai.access<write @y, #[[OWN]]>]
// Launches that would leave the field are found as for tai.load.
// BOUNDS-LABEL: tai.kernel @next
//       BOUNDS:   tai.precondition {{.*}} out of range for field '@x' of shape [8]
//       BOUNDS:   %[[X:.+]] = tai.load @x[
//       BOUNDS:   math.absf %[[X]]
// It has no rule, and is not taken for a constant.
// GRADIENT: error: 'soft.read' reads floats from memory that derivatives are not followed through
tai.kernel @next(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %j = arith.addi %i, %c1 : index
    %0 = soft.read @x[%j] : f64
    tai.store %0, @y[%i] : f64
  }
  tai.return
}
