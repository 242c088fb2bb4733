function [y, s] = $model(u, s, p)
%$MODEL  One sample of $title, an identified model, made by pamid.
%   [y, s] = $model(u)         the first sample: inputs u, outputs y of this instant, s for the next one
%   [y, s] = $model(u, s)      the next sample, $period s later; u is held in between
%   p = $model()               the identified parameters
%   [y, s] = $model(u, [], p)  the first sample with other parameters; in a running model change s.p
%
%   u: $inputs
%   y: $outputs
%   Units are those of the names.
%#codegen
if nargin == 0
    y = parameters();
    s = start(y);
    return
end
if nargin == 1
    s = start(parameters());
elseif nargin == 3
    s = start(p);
end
d = derive(s);
y = zeros(1, $n_outputs);
for part = 1:$substeps
    time = s.samples * $period + (part - 1) * ($period / $substeps);
$update    if part == 1
        y = readings(s, s.x, u, time, d);
    end
    s.x = integrate(s, u, time, d, $period / $substeps);
end
s.samples = s.samples + 1;
end

$functions
