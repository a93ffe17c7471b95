% Reads files of photocurrent in Octave: recordings, rendered frames (frames.h5), tracks of the cache.
%
%   pf = photocurrent_files ();
%   r = pf.recording ("scene.h5");                      % r.events.x, .y, .p, .t; r.frames.dn: [column, row, frame]
%   f = pf.output ("out/quickstart", "solve_all", "tracks");
%   [t_ns, photocurrent] = pf.pixel (f, 64, 48, 128);   % column and row from 0, width of the sensor
%
% Octave reverses dimensions and numbers from 1. Its `load` reads no attributes of HDF5: the scale of codes in frames.h5 is in frames.csv,
% and what a track does between its knots is `between` of `photocurrent inspect FILE --json`.

function pf = photocurrent_files ()
  pf.recording = @recording;
  pf.output = @output;
  pf.pixel = @pixel;
endfunction

function r = recording (file)
  % By name: `load` cannot read the text of /sensor.
  r = load ("-hdf5", file, "events", "frames", "truth");
endfunction

function file = output (run_folder, node, port)
  run = jsondecode (fileread (fullfile (run_folder, "run.json")));
  tasks = run.tasks;
  if (! iscell (tasks))
    tasks = num2cell (tasks);
  endif
  for k = 1:numel (tasks)
    if (strcmp (tasks{k}.label, node))
      file = fullfile (run_folder, run.cache, "data", [tasks{k}.outputs.(port).digest ".h5"]);
      return
    endif
  endfor
  error ("%s has no node %s", run_folder, node);
endfunction

function [t_ns, photocurrent] = pixel (file, x, y, width)
  s = load ("-hdf5", file, "tracks");
  at = y * width + x + 1;
  knots = double (s.tracks.pixel_offsets(at)) + 1 : double (s.tracks.pixel_offsets(at + 1));
  t_ns = s.tracks.t(knots);
  photocurrent = s.tracks.photocurrent(knots);
endfunction
